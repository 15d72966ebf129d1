"""Rigid bodies with mass: free motion, what an impulse does to them, and their rotation.

A body is a centre of mass, a rotation, and a velocity and spin in world axes. Nothing couples it to the rest
but contacts. What a step carries on is momentum: without a moment the angular momentum in world axes stays.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from softsim_core.base import Array
from softsim_core.physics.mechanics.pose import cross, cross_matrix, rotation_exp
from softsim_core.physics.mechanics.state import State

MOST_TURN = 0.25
"""A body turns by at most this angle in [rad] in a part of a step."""

MOST_PARTS = 4000
"""A spin that needs more parts has run away; the step is refused for its speed."""

MOST_ITERATIONS = 20
"""Of Newton's method for a part; three are usual."""


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
            (r, 6); zeros where not given.
        inverse_inertia: In [1/(kg m^2)], body axes, shape (r, 3, 3).
        gyration: Radius of gyration in [m] about the axis of the mean moment, shape (r,).
        even: Whether the inertia is the same about all axes, as of spheres and cubes: the spin stays.
    """

    names: tuple[str, ...]
    mass: Array
    inertia: Array
    rest_positions: Array
    rest_rotations: Array
    rest_velocities: Array = field(default_factory=lambda: np.zeros((0, 6)))
    inverse_inertia: Array = field(init=False)
    gyration: Array = field(init=False)
    even: tuple[bool, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "inverse_inertia", np.linalg.inv(self.inertia))
        mean = np.trace(self.inertia, axis1=1, axis2=2) / 3.0
        object.__setattr__(self, "gyration", np.sqrt(1.5 * mean / self.mass))
        off = np.abs(self.inertia - mean[:, None, None] * np.eye(3)).max(axis=(1, 2), initial=0.0)
        object.__setattr__(self, "even", tuple((off <= 1e-12 * mean).tolist()))
        if not len(self.rest_velocities):
            object.__setattr__(self, "rest_velocities", np.zeros((len(self.names), 6)))

    def predict(self, state: State, gravity: Array, dt: float, loads: Array | None = None) -> None:
        """Add what gravity (3,) [m/s^2] and `loads` do in `dt` [s] to the velocities; positions stay.

        Velocities of a step that is under way, from here to `finish`, are its momentum over the mass, and its
        angular momentum over the inertia at the start of the step: without a moment they stay, and impulses
        add to them what `response` says, exactly.

        Args:
            state: At the start of the step.
            gravity: In [m/s^2], shape (3,).
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
        """Positions and rotations a `dt` after `before`, at the velocities of `state` (see `predict`).

        The spin w in body axes follows the midpoint rule, which keeps energy and the length of the momentum,
        and the rotation is the one near exp(dt (w + w+) / 2) that keeps its direction, too:

            I (w+ - w) + dt m x I m = 0,   m = (w + w+) / 2,   R+ = C R exp(dt m),   R+ I w+ = R I w

        C being the shortest rotation that does it, of third order in dt. A steady spin is exact, all else of
        second order; where a body turns far in a step, the step is cut.

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
            state.rigid_rotations[r] = self._turned(r, rotation, spin, dt)

    def finish(self, state: State, before: State) -> None:
        """Make the velocities of a step that is over those at its end: the same momentum in the new pose."""
        for r, rotation in enumerate(state.rigid_rotations):
            if self.even[r]:
                continue
            first = before.rigid_rotations[r]
            momentum = first @ (self.inertia[r] @ (first.T @ state.rigid_velocities[r, 3:]))
            state.rigid_velocities[r, 3:] = rotation @ (self.inverse_inertia[r] @ (rotation.T @ momentum))

    def _turned(self, r: int, rotation: Array, spin: Array, dt: float) -> Array:
        """Rotation (3, 3) after `dt` without a moment, from a first spin (3,) in body axes."""
        inertia = self.inertia[r]
        held = inertia @ spin
        smallest = 1.0 / np.linalg.norm(self.inverse_inertia[r], 2)
        fastest = np.sqrt(max(spin @ held, 0.0) / smallest)  # that this energy allows
        held = rotation @ held
        parts = dt * fastest / MOST_TURN
        count = int(np.ceil(parts)) if 1.0 < parts <= MOST_PARTS else 1
        for _ in range(count):
            after = _spin_after(inertia, spin, dt / count)
            rotation = rotation @ rotation_exp(0.5 * dt / count * (spin + after))
            rotation = _shortest(rotation @ (inertia @ after), held) @ rotation
            spin = after
        return _orthonormal(rotation)

    def response(self, state: State, rows: Array) -> Array:
        """Velocities and spins a unit of impulse on each row, world axes, for rows (k, 6 r), same shape."""
        result = np.zeros_like(rows)
        for r, rotation in enumerate(state.rigid_rotations):
            linear, angular = slice(6 * r, 6 * r + 3), slice(6 * r + 3, 6 * r + 6)
            result[:, linear] = rows[:, linear] / self.mass[r]
            result[:, angular] = rows[:, angular] @ (rotation @ self.inverse_inertia[r] @ rotation.T)
        return result


def _spin_after(inertia: Array, spin: Array, dt: float) -> Array:
    """Spin (3,) after `dt` by the midpoint rule, in body axes (Newton's method)."""
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
    """The shortest rotation (3, 3) of a vector (3,) into the direction of another one near it."""
    axis = cross(vector, target)
    sine = float(np.linalg.norm(axis))
    angle = np.arctan2(sine, vector @ target)
    return rotation_exp(axis * (angle / sine) if sine > 0.0 else axis)


def no_rigid_bodies() -> RigidBodies:
    """The rigid bodies of a scene without any."""
    return RigidBodies((), np.zeros(0), np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros((0, 3, 3)))


def _orthonormal(rotation: Array) -> Array:
    """The rotation with its rounding errors taken out: a Newton step to its polar factor (Higham 1986)."""
    return np.asarray(1.5 * rotation - 0.5 * rotation @ (rotation.T @ rotation))
