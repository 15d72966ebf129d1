from . import stepper as stepper
from .actuator_rows import (
    PressedFaces as PressedFaces,
    bounded_forces as bounded_forces,
    press_faces as press_faces,
)
from .compile import (
    compiler as compiler,
    kernel as kernel,
)
from .elimination import TOLERANCE as TOLERANCE
from .kinematics import (
    jacobians as jacobians,
    motion_subspace as motion_subspace,
)
from .layout import (
    CellPlaces as CellPlaces,
    Cells as Cells,
    Elements as Elements,
    Motion as Motion,
    Nodes as Nodes,
    Pairs as Pairs,
    StepArrays as StepArrays,
    Work as Work,
)
from .stepper import NumbaStepper as NumbaStepper
