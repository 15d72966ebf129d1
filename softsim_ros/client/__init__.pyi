from .control import (
    format_point as format_point,
    moved_goal as moved_goal,
)
from .discovery import (
    FIRST_WITHIN_S as FIRST_WITHIN_S,
    OTHERS_S as OTHERS_S,
    RobotChoiceError as RobotChoiceError,
    RunningRobot as RunningRobot,
    running_robot as running_robot,
    running_robots as running_robots,
)
from .joints import (
    GoToPose as GoToPose,
    MoveAll as MoveAll,
    MoveJoint as MoveJoint,
    StepJoints as StepJoints,
    decide as decide,
    format_command as format_command,
    format_position as format_position,
)
from .robot_client import (
    CONNECT_WITHIN_S as CONNECT_WITHIN_S,
    ClientError as ClientError,
    RobotClient as RobotClient,
    RobotSession as RobotSession,
    connect as connect,
)
from .services import (
    AsyncService as AsyncService,
    Done as Done,
    LogLine as LogLine,
    Outcome as Outcome,
    RobotLog as RobotLog,
    Warnings as Warnings,
)
from .simulator import (
    Editing as Editing,
    Parameters as Parameters,
    Simulator as Simulator,
)
from .state import (
    STALE_AFTER_S as STALE_AFTER_S,
    BridgeState as BridgeState,
    EffectorPose as EffectorPose,
    RobotState as RobotState,
    Tilt as Tilt,
    commandable as commandable,
    enforces_limits as enforces_limits,
    known_effector as known_effector,
    stationary_commands as stationary_commands,
    with_command as with_command,
    with_inverse as with_inverse,
    with_measurement as with_measurement,
    with_received_command as with_received_command,
)
