"""A rigid carrier, by number: a free rigid body, a free frame, a joint, a joint's base, or the world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from softsim_core.base import Array
from softsim_core.physics.mechanics.model import Model
from softsim_core.physics.mechanics.pose import cross
from softsim_core.physics.mechanics.state import State


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Carrier:
    """The rigid frame that carries something; all numbers -1: the world.

    Attributes:
        rigid: Number of the free rigid body, or -1.
        frame: Number of the free frame, or -1.
        joint: Number of the joint that moves it, or -1.
        base: Number of the joint with it as base, or -1.
    """

    rigid: int = -1
    frame: int = -1
    joint: int = -1
    base: int = -1

    def pose(self, model: Model, state: State) -> tuple[Array, Array]:
        """Return its origin (3,) in [m] and its rotation (3, 3).

        The origin of a free rigid body is its centre of mass.
        """
        if self.rigid >= 0:
            return state.rigid_positions[self.rigid], state.rigid_rotations[self.rigid]
        if self.frame >= 0:
            return state.frame_positions[self.frame], state.frame_rotations[self.frame]
        if self.joint >= 0:
            return model.joint_frame(self.joint, state)
        if self.base >= 0:
            return model.base_frame(self.base, state)
        return np.zeros(3), np.eye(3)

    def list_reduced_coordinates(self, model: Model) -> list[int]:
        """Return the reduced coordinates that move it."""
        if self.frame >= 0:
            return list(range(6 * self.frame, 6 * self.frame + 6))
        if self.joint >= 0:
            return [6 * len(model.frame_names) + j for j in model.chain(self.joint)]
        if self.base >= 0:
            return [6 * len(model.frame_names) + j for j in model.chain(self.base)[:-1]]
        return []

    def twist(self, model: Model, state: State, point: Array) -> tuple[Array, Array]:
        """Return the velocity (3,) in [m/s] of a carried point (3,), and the spin (3,) in [rad/s].

        Both are in world axes. They do not include prescribed motion of bases, such as a shift of all bases.
        """
        if self.rigid >= 0 or self.frame >= 0:
            first = 6 * self.frame
            of_frame, of_rigid = state.reduced_velocities[first : first + 6], state.rigid_velocities
            velocity, spin = np.split(of_rigid[self.rigid] if self.rigid >= 0 else of_frame, 2)
            return velocity + cross(spin, point - self.pose(model, state)[0]), spin
        moved = self.list_reduced_coordinates(model)
        if not moved:
            return np.zeros(3), np.zeros(3)
        speeds, motions = state.reduced_velocities[moved], model.motion_subspace(state)
        return (
            np.asarray(speeds @ motions.jacobians(np.array(moved), point[None])[0]),
            np.asarray(speeds @ motions.angular[moved]),
        )
