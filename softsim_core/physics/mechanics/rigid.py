"""Rigid bodies with mass: free motion, the response to impulses, and rotation.

A body is a centre of mass, a rotation, and a velocity and spin in world axes. Only contacts couple it to the
rest. A step conserves momentum: without a moment the angular momentum in world axes stays the same.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from softsim_core.base import Array
from softsim_core.physics.mechanics.pose import cross, cross_matrix, rotation_exp
from softsim_core.physics.mechanics.state import State

MOST_TURN = 0.25
"""Largest angle in [rad] that a body turns in a part of a step."""

MOST_PARTS = 4000
"""Most parts of a step; a spin that needs more has diverged, and the step is refused for its speed."""

MOST_ITERATIONS = 20
"""Most iterations of Newton's method per part; three are usual."""


@dataclass(frozen=True, slots=True, eq=False)
class RigidBodies:
    """All rigid bodies with mass of a scene.

    Attributes:
        names: Their names.
        mass: Masses in [kg], shape (r,).
        inertia: Inertia about the centre of mass in body axes in [kg m^2], shape (r, 3, 3).
        rest_positions: Centres of mass at the start in [m], shape (r, 3).
        rest_rotations: Rotations at the start, shape (r, 3, 3).
        rest_velocities: Velocity in [m/s] and angular velocity in [rad/s] at the start, world axes, shape
            (r, 6); zeros by default.
        inverse_inertia: Inverse of the inertia in [1/(kg m^2)], body axes, shape (r, 3, 3).
        gyration: Radius of gyration in [m] about the axis of the mean moment, shape (r,).
        speeds: Factors that make velocities and spins comparable speeds: 1 and `gyration`, shape (r, 6).
        even: Whether the inertia is the same about all axes, as for spheres and cubes: the spin stays
            constant.
    """

    names: tuple[str, ...]
    mass: Array
    inertia: Array
    rest_positions: Array
    rest_rotations: Array
    rest_velocities: Array = field(default_factory=lambda: np.zeros((0, 6)))
    inverse_inertia: Array = field(init=False)
    gyration: Array = field(init=False)
    speeds: Array = field(init=False)
    even: tuple[bool, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "inverse_inertia", np.linalg.inv(self.inertia))
        mean = np.trace(self.inertia, axis1=1, axis2=2) / 3.0
        object.__setattr__(self, "gyration", np.sqrt(1.5 * mean / self.mass))
        object.__setattr__(
            self, "speeds", np.repeat(np.column_stack([np.ones(len(mean)), self.gyration]), 3, 1)
        )
        off = np.abs(self.inertia - mean[:, None, None] * np.eye(3)).max(axis=(1, 2), initial=0.0)
        object.__setattr__(self, "even", tuple((off <= 1e-12 * mean).tolist()))
        if not len(self.rest_velocities):
            object.__setattr__(self, "rest_velocities", np.zeros((len(self.names), 6)))

    def predict(self, state: State, gravity: Array, dt: float, loads: Array | None = None) -> None:
        """Add the effects of gravity (3,) [m/s^2] and `loads` over `dt` [s] to the velocities.

        Positions stay.

        Velocities during a step, from here to `finish`, are the momentum divided by the mass, and the angular
        momentum divided by the inertia at the start of the step: without a moment they stay the same, and the
        effect of impulses on them is exactly `response`.

        Args:
            state: State at the start of the step.
            gravity: Gravity in [m/s^2], shape (3,).
            dt: Length of the step in [s].
            loads: Force in [N] at the centre of mass and moment in [N m] about it, world axes, shape (r, 6).
        """
        state.rigid_velocities[:, :3] += dt * gravity
        if loads is None or not loads.any():
            return
        state.rigid_velocities[:, :3] += dt * loads[:, :3] / self.mass[:, None]
        for r, rotation in enumerate(state.rigid_rotations):
            moment = rotation.T @ loads[r, 3:]
            state.rigid_velocities[r, 3:] += dt * (rotation @ (self.inverse_inertia[r] @ moment))

    def advance(self, state: State, before: State, dt: float) -> None:
        """Set positions and rotations a `dt` after `before`, at the velocities of `state` (see `predict`).

        The spin w in body axes follows the midpoint rule, which conserves energy and the length of the
        momentum. The rotation is the one near exp(dt (w + w+) / 2) that also conserves the direction of the
        momentum:

            I (w+ - w) + dt m x I m = 0,   m = (w + w+) / 2,   R+ = C R exp(dt m),   R+ I w+ = R I w

        C is the shortest rotation that achieves this, of third order in dt. A steady spin is exact,
        everything else of second order; if a body turns far in a step, the step is cut.

        Source: Simo and Wong 1991, Unconditionally stable algorithms for rigid body dynamics that exactly
        preserve energy and momentum (the conditions); Krysl 2005 (momentum in world axes).
        """
        state.rigid_positions[:] = before.rigid_positions + dt * state.rigid_velocities[:, :3]
        for r, rotation in enumerate(before.rigid_rotations):
            if self.even[r]:
                turn = rotation_exp(dt * state.rigid_velocities[r, 3:])
                state.rigid_rotations[r] = _orthonormal(turn @ rotation)
                continue
            spin = rotation.T @ state.rigid_velocities[r, 3:]
            state.rigid_rotations[r] = self._rotate_freely(r, rotation, spin, dt)

    def finish(self, state: State, before: State) -> None:
        """Convert velocities of a finished step to those at its end: the same momentum in the new pose."""
        for r, rotation in enumerate(state.rigid_rotations):
            if self.even[r]:
                continue
            first = before.rigid_rotations[r]
            momentum = first @ (self.inertia[r] @ (first.T @ state.rigid_velocities[r, 3:]))
            state.rigid_velocities[r, 3:] = rotation @ (self.inverse_inertia[r] @ (rotation.T @ momentum))

    def _rotate_freely(self, r: int, rotation: Array, spin: Array, dt: float) -> Array:
        """Return the rotation (3, 3) after `dt` without a moment, from an initial spin (3,) in body axes."""
        inertia = self.inertia[r]
        momentum = inertia @ spin
        smallest = 1.0 / np.linalg.norm(self.inverse_inertia[r], 2)
        fastest = np.sqrt(max(spin @ momentum, 0.0) / smallest)  # that this energy allows
        momentum = rotation @ momentum
        parts = dt * fastest / MOST_TURN
        count = int(np.ceil(parts)) if 1.0 < parts <= MOST_PARTS else 1
        for _ in range(count):
            after = _spin_after(inertia, spin, dt / count)
            rotation = rotation @ rotation_exp(0.5 * dt / count * (spin + after))
            rotation = _shortest(rotation @ (inertia @ after), momentum) @ rotation
            spin = after
        return _orthonormal(rotation)

    def response(self, state: State, rows: Array) -> Array:
        """Return velocities and spins per unit of impulse on each row.

        They are in world axes, of the shape of rows (k, 6 r).
        """
        result = np.zeros_like(rows)
        for r, rotation in enumerate(state.rigid_rotations):
            linear, angular = slice(6 * r, 6 * r + 3), slice(6 * r + 3, 6 * r + 6)
            result[:, linear] = rows[:, linear] / self.mass[r]
            result[:, angular] = rows[:, angular] @ (rotation @ self.inverse_inertia[r] @ rotation.T)
        return result


def _spin_after(inertia: Array, spin: Array, dt: float) -> Array:
    """Return the spin (3,) after `dt` by the midpoint rule, in body axes (Newton's method)."""
    after = spin
    enough = 1e-15 * float(np.abs(inertia @ spin).max())
    for _ in range(MOST_ITERATIONS):
        mean = 0.5 * (spin + after)
        momentum = inertia @ mean
        residual = inertia @ (after - spin) + dt * cross(mean, momentum)
        if not np.abs(residual).max() > enough:  # also ends on NaN
            break
        slope = inertia + 0.5 * dt * (cross_matrix(mean) @ inertia - cross_matrix(momentum))
        after = after - np.linalg.solve(slope, residual)
    return np.asarray(after)


def _shortest(vector: Array, target: Array) -> Array:
    """Return the shortest rotation (3, 3) of a vector (3,) into the direction of another one near it."""
    axis = cross(vector, target)
    sine = float(np.linalg.norm(axis))
    angle = np.arctan2(sine, vector @ target)
    return rotation_exp(axis * (angle / sine) if sine > 0.0 else axis)


def no_rigid_bodies() -> RigidBodies:
    """Return the rigid bodies of a scene without any."""
    return RigidBodies((), np.zeros(0), np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros((0, 3, 3)))


def _orthonormal(rotation: Array) -> Array:
    """Return the rotation without its rounding errors: a Newton step to its polar factor (Higham 1986)."""
    return np.asarray(1.5 * rotation - 0.5 * rotation @ (rotation.T @ rotation))
