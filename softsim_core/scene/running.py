"""What a scene's own code sees of the simulation that runs it; `softsim_core.Simulation` is one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from softsim_core.arrays import Array
from softsim_core.mechanics.pose import Pose


class RunningSimulation(Protocol):
    """The part of a simulation that controllers and animations of a scene rely on.

    Attributes:
        forces: External forces on the nodes in [N], shape (n, 3); written by the scene's code at will.
        base_shift: Shift in [m] of all joint bases along their slide axes.
    """

    forces: Array
    base_shift: float

    @property
    def time(self) -> float:
        """Simulated time in [s]."""
        ...

    @property
    def dt(self) -> float:
        """Time step in [s]."""
        ...

    @property
    def step_count(self) -> int:
        """Steps since the start."""
        ...

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joint names in command order."""
        ...

    @property
    def joint_positions(self) -> Array:
        """Measured joint positions in [rad] or [m], shape (j,)."""
        ...

    @property
    def joint_targets(self) -> Array:
        """The last accepted command in [rad] or [m], shape (j,)."""
        ...

    @property
    def effector_pose(self) -> Pose | None:
        """Pose of the end effector, or None in a scene without one."""
        ...

    def command(self, values: Sequence[float] | Array) -> Array:
        """Set where the joints go; returns the accepted command in [rad] or [m], shape (j,)."""
        ...
