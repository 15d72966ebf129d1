"""The inputs of a running model: the commands of one step, and the parameters that a user tunes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from softsim_core.base import Array, float_array


class Transmissions(NamedTuple):
    """Constraints of c actuators: s - q + c t = 0 while t is within its bounds; see actuation.actuators.

    Attributes:
        command: q, shape (c,).
        compliance: c >= 0, shape (c,).
        lower, upper: Bounds of the multipliers t, shapes (c,).
        gain: Growth of q per unit of the command, shape (c,).
    """

    command: Array
    compliance: Array
    lower: Array
    upper: Array
    gain: Array


@dataclass(frozen=True, slots=True, eq=False)
class Control:
    """Commands, forces and motions of one step.

    Attributes:
        targets: Commanded position of each joint at the end of the step, in [rad] or [m], shape (j,).
        forces: External forces on the nodes in [N], shape (n, 3).
        base_shift: Shift in [m] of the joint bases at the end of the step. Bases are moved, not driven: their
            velocity stays zero, and the body feels the move from the next step on.
        rigid_forces: Force in [N] at the centre of mass of each rigid body with mass and moment in [N m]
            about it, world axes, shape (r, 6); None: none.
        carried: Velocities in [m/s] of the nodes, shape (n, 3), that damping per stiffness uses in addition
            to those of the state; None: none.
        transmissions: Constraints of the actuators during the step, if some of them have a history; None: the
            constraints follow from the targets alone.

    Raises:
        ArrayError: an array has another number of axes or columns, or its values are not real numbers. Other
            arrays are converted to float64, row by row, as compiled kernels expect.
    """

    targets: Array
    forces: Array
    base_shift: float = 0.0
    rigid_forces: Array | None = None
    carried: Array | None = None
    transmissions: Transmissions | None = None

    def __post_init__(self) -> None:
        store = object.__setattr__
        store(self, "targets", float_array(self.targets, (-1,), "targets"))
        store(self, "forces", float_array(self.forces, (-1, 3), "forces"))
        store(self, "base_shift", float(self.base_shift))
        if self.rigid_forces is not None:
            loads = float_array(self.rigid_forces, (-1, 6), "rigid_forces")
            store(self, "rigid_forces", loads)
        if self.carried is not None:
            store(self, "carried", float_array(self.carried, (-1, 3), "carried"))

    def check(self, joints: int, nodes: int) -> None:
        """Refuse arrays that do not fit a model with these numbers of joints and nodes.

        Raises:
            ArrayError: targets or forces of another length.
        """
        if len(self.targets) != joints:
            float_array(self.targets, (joints,), "targets")
        if len(self.forces) != nodes:
            float_array(self.forces, (nodes, 3), "forces")


@dataclass(slots=True, eq=False)
class Parameters:
    """Parameters that a user may tune while the simulation runs.

    Attributes:
        materials: Parameters by name of each body's material law, then of each body's layers and fibres.
        rayleigh_stiffness: Damping per stiffness in [s].
        rayleigh_mass: Damping per mass in [1/s].
    """

    materials: list[dict[str, float]]
    rayleigh_stiffness: float
    rayleigh_mass: float
