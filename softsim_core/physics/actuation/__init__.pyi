from .actuators import (
    Actuator as Actuator,
    Actuators as Actuators,
    ActuatorView as ActuatorView,
    Constraints as Constraints,
    GeometricStiffness as GeometricStiffness,
    MeasuredSize as MeasuredSize,
    PlainGroup as PlainGroup,
    Transmission as Transmission,
    no_geometric_stiffness as no_geometric_stiffness,
    pressed_blocks as pressed_blocks,
)
from .building import (
    ActuatorDescription as ActuatorDescription,
    ActuatorKind as ActuatorKind,
    EditedNumber as EditedNumber,
    Gas as Gas,
    Placed as Placed,
    Points as Points,
    Route as Route,
    Surroundings as Surroundings,
)
from .joint_drive import drive_stiffness as drive_stiffness
from .load import (
    LoadDescription as LoadDescription,
    MomentLoad as MomentLoad,
)
from .registry import (
    FRAME_KINDS as FRAME_KINDS,
    actuator_kinds as actuator_kinds,
    described_kinds as described_kinds,
    register_actuator as register_actuator,
)
from .trajectory import (
    JointTrajectory as JointTrajectory,
    Mode as Mode,
    check_animation as check_animation,
    factor_at as factor_at,
    is_over as is_over,
)
