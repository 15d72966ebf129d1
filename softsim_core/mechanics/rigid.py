"""Rigid bodies with mass: free motion, what an impulse does to them, and their rotation.

A body is a centre of mass, a rotation, and a velocity and spin in world axes. Nothing couples it to the rest
but contacts.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from softsim_core.arrays import Array
from softsim_core.mechanics.pose import cross, cross_matrix, rotation_exp
from softsim_core.mechanics.state import State


@dataclass(frozen=True, slots=True, eq=False)
class RigidBodies:
    """All rigid bodies with mass of a scene.

    Attributes:
        names: Their names.
        mass: Masses in [kg], shape (r,).
        inertia: Inertia about the centre of mass in body axes in [kg m^2], shape (r, 3, 3).
        rest_positions: Centres of mass at the start in [m], shape (r, 3).
        rest_rotations: Rotations at the start, shape (r, 3, 3).
        inverse_inertia: In [1/(kg m^2)], body axes, shape (r, 3, 3).
    """

    names: tuple[str, ...]
    mass: Array
    inertia: Array
    rest_positions: Array
    rest_rotations: Array
    inverse_inertia: Array = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "inverse_inertia", np.linalg.inv(self.inertia))

    def predict(self, state: State, gravity: Array, dt: float) -> None:
        """Velocities after `dt` of free motion under gravity (3,) [m/s^2]; positions stay.

        The gyroscopic moment is taken implicitly (one Newton step in body axes), so that fast spin neither
        gains energy nor blows up. Source: Catto 2015, Numerical methods (gyroscopic torque).
        """
        state.rigid_velocities[:, :3] += dt * gravity
        for r, rotation in enumerate(state.rigid_rotations):
            spin = rotation.T @ state.rigid_velocities[r, 3:]
            momentum = self.inertia[r] @ spin
            residual = dt * cross(spin, momentum)
            if not residual.any():
                continue
            slope = self.inertia[r] + dt * (cross_matrix(spin) @ self.inertia[r] - cross_matrix(momentum))
            state.rigid_velocities[r, 3:] = rotation @ (spin - np.linalg.solve(slope, residual))

    def advance(self, state: State, before: State, dt: float) -> None:
        """Positions and rotations a `dt` after `before`, at the velocities of `state`."""
        state.rigid_positions[:] = before.rigid_positions + dt * state.rigid_velocities[:, :3]
        for r, spin in enumerate(state.rigid_velocities[:, 3:]):
            state.rigid_rotations[r] = _orthonormal(rotation_exp(dt * spin) @ before.rigid_rotations[r])

    def response(self, state: State, rows: Array) -> Array:
        """Velocities and spins a unit of impulse on each row, world axes, for rows (k, 6 r), same shape."""
        result = np.zeros_like(rows)
        for r, rotation in enumerate(state.rigid_rotations):
            linear, angular = slice(6 * r, 6 * r + 3), slice(6 * r + 3, 6 * r + 6)
            result[:, linear] = rows[:, linear] / self.mass[r]
            result[:, angular] = rows[:, angular] @ (rotation @ self.inverse_inertia[r] @ rotation.T)
        return result


def no_rigid_bodies() -> RigidBodies:
    """The rigid bodies of a scene without any."""
    return RigidBodies((), np.zeros(0), np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros((0, 3, 3)))


def _orthonormal(rotation: Array) -> Array:
    """The rotation with its rounding errors taken out: a Newton step to its polar factor (Higham 1986)."""
    return np.asarray(1.5 * rotation - 0.5 * rotation @ (rotation.T @ rotation))
