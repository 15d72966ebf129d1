from . import recorder_node as recorder_node
from .bag import Bag as Bag
from .bag_writer import (
    BagWriter as BagWriter,
    repair as repair,
)
from .curves import (
    Chart as Chart,
    Curve as Curve,
    charts as charts,
    draw as draw,
)
from .errors import (
    BagError as BagError,
    RecordingError as RecordingError,
)
from .integrity import (
    MAGIC as MAGIC,
    is_torn as is_torn,
)
from .recorder_node import (
    Recorder as Recorder,
    Selection as Selection,
)
from .replay_node import (
    Replay as Replay,
    ReplayClock as ReplayClock,
)
from .replay_page import html_replay as html_replay
from .report_page import report as report
from .run_bag import RunBags as RunBags
from .surface_frames import (
    SURFACE as SURFACE,
    VOLUME as VOLUME,
    mesh_frames as mesh_frames,
    write_vtu_series as write_vtu_series,
)
from .tables import (
    read_bag as read_bag,
    register as register,
    write_csv as write_csv,
)
