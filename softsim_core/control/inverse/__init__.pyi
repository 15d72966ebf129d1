from .closed_loop import (
    COLUMNS as COLUMNS,
    ClosedLoopLog as ClosedLoopLog,
    TiltController as TiltController,
    TiltGains as TiltGains,
    Tilts as Tilts,
    read_closed_loop_log as read_closed_loop_log,
    tilt_rotation as tilt_rotation,
    tilts_of as tilts_of,
)
from .controller import (
    InverseController as InverseController,
    InverseReport as InverseReport,
    pose_difference as pose_difference,
)
from .pacing import (
    AdaptiveDamping as AdaptiveDamping,
    Pace as Pace,
    pace as pace,
    slowest_period as slowest_period,
)
from .paths import (
    MAZE_LIFT_M as MAZE_LIFT_M,
    EffectorPath as EffectorPath,
    PathRefusedError as PathRefusedError,
    find_path as find_path,
    is_known_path as is_known_path,
    known_path as known_path,
    known_paths as known_paths,
    maze_path as maze_path,
    read_csv_path as read_csv_path,
    read_maze_plan as read_maze_plan,
    read_path as read_path,
)
from .problem import (
    QP as QP,
    Constraint as Constraint,
    Limits as Limits,
    Linearisation as Linearisation,
    build as build,
    kkt_residual as kkt_residual,
    need_daqp as need_daqp,
    scales as scales,
    solve as solve,
    torque_rows as torque_rows,
)
from .sensitivity import (
    Sensitivity as Sensitivity,
    analytic_sensitivity as analytic_sensitivity,
    sampled_sensitivity as sampled_sensitivity,
)
from .static import (
    PoseSolution as PoseSolution,
    effector as effector,
    place as place,
    solve_pose as solve_pose,
    solve_taut as solve_taut,
    walk as walk,
)
from .tasks import (
    HeightTiltTask as HeightTiltTask,
    OrientationTask as OrientationTask,
    PoseTask as PoseTask,
    PositionTask as PositionTask,
    Task as Task,
    scale_to_limits as scale_to_limits,
    task_for as task_for,
    tilt_of as tilt_of,
)
from .workspace import (
    Workspace as Workspace,
    reach as reach,
    sample_workspace as sample_workspace,
)
