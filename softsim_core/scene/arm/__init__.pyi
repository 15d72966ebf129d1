from .description import (
    ArmDescription as ArmDescription,
    ToolDescription as ToolDescription,
)
from .mounting import arm_with_tools as arm_with_tools
from .urdf_file import (
    RigidRobot as RigidRobot,
    read_urdf as read_urdf,
)
