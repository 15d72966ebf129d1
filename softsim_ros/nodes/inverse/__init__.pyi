from . import (
    closed_loop_node as closed_loop_node,
    inverse_node as inverse_node,
    path_follower_node as path_follower_node,
)
from .closed_loop_node import (
    ClosedLoop as ClosedLoop,
    TiltLoop as TiltLoop,
    imu_tilts as imu_tilts,
    pose_tilts as pose_tilts,
)
from .control_thread import (
    STUCK_AFTER_S as STUCK_AFTER_S,
    CommandsOut as CommandsOut,
    ControlStatus as ControlStatus,
    FollowingCheck as FollowingCheck,
    has_moved as has_moved,
)
from .inverse_node import InverseControl as InverseControl
from .inverse_switch import health as health
from .parameters import ControllerSettings as ControllerSettings
from .path_follower_node import (
    PathFollower as PathFollower,
    PathPlayer as PathPlayer,
)
from .plant import (
    FARTHEST_M as FARTHEST_M,
    FEEDBACK_WITHIN_S as FEEDBACK_WITHIN_S,
    SILENT_AFTER_S as SILENT_AFTER_S,
    Plant as Plant,
    SimulatedRobot as SimulatedRobot,
    check_frame as check_frame,
    checked_pose as checked_pose,
    effector_rest as effector_rest,
    unit_quaternion as unit_quaternion,
)
