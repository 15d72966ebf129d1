from .engine import (
    MujocoRun as MujocoRun,
    look_at as look_at,
)
from .exporting import (
    ITERATIONS as ITERATIONS,
    ExportedModel as ExportedModel,
    export_mjcf as export_mjcf,
)
from .importing import (
    ImportedScene as ImportedScene,
    import_mjcf as import_mjcf,
    write_imported as write_imported,
)
from .source import read_source as read_source
