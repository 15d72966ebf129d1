from .cluster import (
    AHEAD as AHEAD,
    Engine as Engine,
    StudySummary as StudySummary,
    SweepOptions as SweepOptions,
    Where as Where,
    engine as engine,
    sweep as sweep,
)
from .description import (
    CommandStep as CommandStep,
    DesignDescription as DesignDescription,
    ObjectiveDescription as ObjectiveDescription,
    QuantityDescription as QuantityDescription,
    StudyDescription as StudyDescription,
    VariableDescription as VariableDescription,
    known_studies as known_studies,
    load_study as load_study,
)
from .optimisation import (
    OBJECTIVE as OBJECTIVE,
    optimise as optimise,
    quadratic_minimum as quadratic_minimum,
    response_surface as response_surface,
)
from .preparing import (
    PreparedStudy as PreparedStudy,
    prepare_study as prepare_study,
    values_of_runs as values_of_runs,
)
from .single import (
    DIVERGED as DIVERGED,
    DONE as DONE,
    LATE as LATE,
    RAISED as RAISED,
    Outcome as Outcome,
    run_once as run_once,
)
from .store import (
    Store as Store,
    StudyResults as StudyResults,
    read_results as read_results,
    scene_hash as scene_hash,
    write_parquet as write_parquet,
)
