from . import (
    finger_mesh as finger_mesh,
    gripper_parts as gripper_parts,
    maze_mesh as maze_mesh,
    parts as parts,
    pneu_arm_mesh as pneu_arm_mesh,
    pneu_finger_mesh as pneu_finger_mesh,
    tentacle_mesh as tentacle_mesh,
    tripod_mesh as tripod_mesh,
)
from .finger_mesh import (
    finger as finger,
)
from .gripper_parts import (
    cable_finger as cable_finger,
    cable_gripper as cable_gripper,
    rigid_thing as rigid_thing,
)
from .maze_mesh import (
    maze_plate as maze_plate,
)
from .parts import (
    WheelSpring as WheelSpring,
    actuated_arm as actuated_arm,
    bend_keys as bend_keys,
    bending_commands as bending_commands,
    elastic_body as elastic_body,
    fixing_box as fixing_box,
    move_all as move_all,
    servo as servo,
    tripod as tripod,
    tripod_silicone as tripod_silicone,
)
from .pneu_arm_mesh import (
    ArmShape as ArmShape,
    pneu_arm as pneu_arm,
)
from .pneu_finger_mesh import (
    pneu_finger as pneu_finger,
)
from .tentacle_mesh import (
    tentacle as tentacle,
)
