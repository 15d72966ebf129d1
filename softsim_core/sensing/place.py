"""Frames in which sensors measure: fixed in something that moves rigidly."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from softsim_core.arrays import Array
from softsim_core.mechanics.carrier import Carrier
from softsim_core.mechanics.model import Model
from softsim_core.mechanics.pose import rotation_euler
from softsim_core.mechanics.state import State
from softsim_core.values import Placement


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """A frame in a carrier.

    Attributes:
        carrier: What carries it.
        position: Its origin in the carrier's frame in [m], shape (3,).
        rotation: Its rotation there, shape (3, 3).
    """

    carrier: Carrier
    position: Array = field(default_factory=lambda: np.zeros(3))
    rotation: Array = field(default_factory=lambda: np.eye(3))

    def within(self, placement: Placement) -> Place:
        """The frame at a placement in this one (its scale is not used)."""
        shift = np.array(placement.translation, dtype=float)
        turn = rotation_euler(np.radians(placement.rotation_deg))
        return Place(self.carrier, self.position + self.rotation @ shift, self.rotation @ turn)

    def pose(self, model: Model, state: State) -> tuple[Array, Array]:
        """Origin (3,) in [m] and rotation (3, 3) in the world."""
        origin, rotation = self.carrier.pose(model, state)
        return origin + rotation @ self.position, rotation @ self.rotation

    def twist(self, model: Model, state: State) -> tuple[Array, Array]:
        """Velocity (3,) of the origin in [m/s] and spin (3,) in [rad/s], world axes."""
        return self.carrier.twist(model, state, self.pose(model, state)[0])
