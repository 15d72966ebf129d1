from . import simulator_node as simulator_node
from .inputs import (
    is_turned as is_turned,
    limited_force as limited_force,
    pulled_nodes as pulled_nodes,
)
from .monitor import (
    Fallbacks as Fallbacks,
    Pacer as Pacer,
    RateGate as RateGate,
    SpeedMeter as SpeedMeter,
    StageTime as StageTime,
    StepHistory as StepHistory,
)
from .object_markers import (
    FORCE_LENGTH as FORCE_LENGTH,
    bodies_topology as bodies_topology,
    cable_markers as cable_markers,
    cable_places as cable_places,
    chamber_markers as chamber_markers,
    chamber_places as chamber_places,
    collision_markers as collision_markers,
    collision_places as collision_places,
    contact_markers as contact_markers,
    pressure_colour as pressure_colour,
)
from .parameters import (
    tunables as tunables,
    with_values as with_values,
)
from .physics_thread import (
    PhysicsStatus as PhysicsStatus,
    PhysicsThread as PhysicsThread,
    printed_lines as printed_lines,
)
from .publications import (
    Publications as Publications,
    stage_statistics as stage_statistics,
)
from .scene_editing import SceneWriter as SceneWriter
from .scene_files import (
    CompiledLater as CompiledLater,
    SceneBuilder as SceneBuilder,
    SceneFiles as SceneFiles,
    files_of as files_of,
)
from .scene_topics import (
    FrameTree as FrameTree,
    index_array as index_array,
    structure as structure,
)
from .services import (
    SnapshotFolder as SnapshotFolder,
    default_folder as default_folder,
    default_name as default_name,
)
from .setpoints import (
    Commanded as Commanded,
    Progress as Progress,
)
from .simulator_node import (
    Simulator as Simulator,
    health as health,
    main as main,
)
from .trajectory_action import (
    End as End,
    FollowedGoal as FollowedGoal,
    check_reachable as check_reachable,
    followed_goal as followed_goal,
)
