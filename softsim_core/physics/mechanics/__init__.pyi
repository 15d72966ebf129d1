from .carrier import Carrier as Carrier
from .control import (
    Control as Control,
    Parameters as Parameters,
    Transmissions as Transmissions,
)
from .limits import (
    ARRIVED as ARRIVED,
    JointLimits as JointLimits,
    check_age as check_age,
    check_command as check_command,
    check_named_command as check_named_command,
    check_positions_only as check_positions_only,
    says_something as says_something,
)
from .model import (
    FIXED as FIXED,
    FREE as FREE,
    Joint as Joint,
    Model as Model,
    MotionSubspace as MotionSubspace,
    RigidRegion as RigidRegion,
)
from .pose import (
    Pose as Pose,
    cross as cross,
    cross_matrices as cross_matrices,
    cross_matrix as cross_matrix,
    euler_of as euler_of,
    nearest_rotation as nearest_rotation,
    quaternion_of as quaternion_of,
    rotation_euler as rotation_euler,
    rotation_exp as rotation_exp,
    rotation_log as rotation_log,
    rotation_of as rotation_of,
)
from .rigid import (
    RigidBodies as RigidBodies,
    no_rigid_bodies as no_rigid_bodies,
)
from .rows import (
    Rows as Rows,
    distribute as distribute,
    join_rows as join_rows,
    no_rows as no_rows,
    sparse_rows as sparse_rows,
)
from .state import (
    ACCELERATION as ACCELERATION,
    ACTUATOR_STATE as ACTUATOR_STATE,
    COMMANDED as COMMANDED,
    EFFORT_CHANGE as EFFORT_CHANGE,
    HOLDING as HOLDING,
    MAGIC as MAGIC,
    MOVED as MOVED,
    PASSIVE_EFFORTS as PASSIVE_EFFORTS,
    REDUCED_ACCELERATION as REDUCED_ACCELERATION,
    WARM_START_COLUMNS as WARM_START_COLUMNS,
    State as State,
    memory_name as memory_name,
    need_rotations as need_rotations,
    no_warm_start as no_warm_start,
    pack as pack,
    step_stress_name as step_stress_name,
    unpack as unpack,
)
