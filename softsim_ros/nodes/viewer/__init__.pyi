from . import viewer_node as viewer_node
from .edit_mode import (
    MOST_WAITING as MOST_WAITING,
    EditMode as EditMode,
    first_hit as first_hit,
    lines_of as lines_of,
    status as status,
)
from .edit_session import (
    CHOOSE as CHOOSE,
    CLICKS as CLICKS,
    ROUTE as ROUTE,
    EditSession as EditSession,
    drag_handle as drag_handle,
)
from .guard import (
    MOST_REFUSED as MOST_REFUSED,
    AccessRule as AccessRule,
    GuardedServer as GuardedServer,
    ViewerError as ViewerError,
    is_loopback as is_loopback,
    passes as passes,
)
from .inner_view import (
    CollisionView as CollisionView,
    InnerView as InnerView,
    NormalsView as NormalsView,
)
from .marker_view import (
    GAMMA as GAMMA,
    SLACK_COLOUR as SLACK_COLOUR,
    TENSION_COLOURS as TENSION_COLOURS,
    MarkerView as MarkerView,
    RigidView as RigidView,
    TensionColours as TensionColours,
    facing as facing,
    marker_colour as marker_colour,
    marker_points as marker_points,
)
from .panel import (
    Control as Control,
    Inbox as Inbox,
)
from .parameters import (
    ViewerSettings as ViewerSettings,
    requested_token as requested_token,
    tunables as tunables,
)
from .part_tree import (
    field_text as field_text,
    field_value as field_value,
    parts_of as parts_of,
)
from .picture import (
    Picture as Picture,
    landmarks as landmarks,
)
from .profiler import (
    Profile as Profile,
    stage_table as stage_table,
    step_table as step_table,
)
from .readings import (
    LAYERS as LAYERS,
    command_of as command_of,
    joint_range as joint_range,
    progress as progress,
    slider_label as slider_label,
    slider_value as slider_value,
    tension_legend as tension_legend,
    view_file as view_file,
)
from .stage import (
    CAMERA_FOV as CAMERA_FOV,
    CELLS as CELLS,
    HOLLOW_OFFSET_MM as HOLLOW_OFFSET_MM,
    BaseHandle as BaseHandle,
    Pull as Pull,
    Trail as Trail,
    camera_for as camera_for,
    find_covered_pixels as find_covered_pixels,
    floor_height as floor_height,
    for_window as for_window,
    shade as shade,
    spread_over as spread_over,
)
from .surface import (
    BANDS as BANDS,
    MM as MM,
    Part as Part,
    SurfaceView as SurfaceView,
    band_colours as band_colours,
    bands_of as bands_of,
    box_lines as box_lines,
    compact as compact,
    normal_lines as normal_lines,
    round_up as round_up,
    select_visible as select_visible,
    shrunk_faces as shrunk_faces,
    sphere_lines as sphere_lines,
)
from .tabs import (
    PlotsTab as PlotsTab,
    TuneTab as TuneTab,
    ViewTab as ViewTab,
    have_same_controls as have_same_controls,
    hotkeys as hotkeys,
    joint_at as joint_at,
    key_label as key_label,
    key_rows as key_rows,
    page_keys as page_keys,
)
from .viewer_node import Viewer as Viewer
