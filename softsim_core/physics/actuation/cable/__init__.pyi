from .cables import (
    CABLE as CABLE,
    IN_BODY as IN_BODY,
    IN_WORLD as IN_WORLD,
    CableArrays as CableArrays,
    Cables as Cables,
    CableView as CableView,
    line_stiffness as line_stiffness,
)
from .description import (
    CableDescription as CableDescription,
    read_cable_points as read_cable_points,
)
