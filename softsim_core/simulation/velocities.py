"""Setting velocities and places: what may be set, and what follows from it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from softsim_core.arrays import Array
from softsim_core.errors import CommandError
from softsim_core.mechanics.model import Model
from softsim_core.mechanics.pose import cross, rotation_of
from softsim_core.mechanics.state import State
from softsim_core.scene.body import Body
from softsim_core.wrong_names import known_names

ROUNDED: Final = 1e-3
"""By so much the length of a unit quaternion may differ from 1: those of messages are often of few digits."""


def checked(what: str, values: ArrayLike, shape: tuple[int, ...], unit: str) -> Array:
    """The values as a new float64 array of a shape.

    Raises:
        CommandError: not numbers, another shape, or not finite.
    """
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise CommandError(f"{what} must be numbers in {unit}, shape {shape}; nothing was changed") from None
    if array.shape != shape:
        raise CommandError(
            f"{what} of shape {array.shape} refused: expected shape {shape} in {unit}; nothing was changed"
        )
    if not np.isfinite(array).all():
        worst = np.argwhere(~np.isfinite(array))[0].tolist()
        raise CommandError(
            f"{what} refused: the value at {worst} is not finite; expected numbers in {unit}; "
            "nothing was changed"
        )
    return array


def rotation_from(quaternion_xyzw: ArrayLike) -> Array:
    """Rotation matrix (3, 3) of a quaternion whose length is 1 but for rounding.

    Raises:
        CommandError: it is none.
    """
    quaternion = checked("quaternion", quaternion_xyzw, (4,), "x, y, z, w")
    length = float(np.linalg.norm(quaternion))
    if abs(length - 1.0) > ROUNDED:
        raise CommandError(f"quaternion of length {length:g} refused: expected 1; nothing was changed")
    return rotation_of(quaternion / length)


def set_node_velocities(model: Model, state: State, velocities: Array) -> None:
    """Velocities (n, 3) in [m/s] of the free nodes; those that are fixed or follow something keep theirs."""
    free = model.free_nodes
    state.velocities[free] = velocities[free]


def set_body_motion(model: Model, state: State, body: Body, velocity: Array, angular_velocity: Array) -> None:
    """Move a body as if it were rigid, its free frames too; see Simulation.set_body_velocity."""
    nodes = np.arange(body.nodes.start, body.nodes.stop)
    mass, points = model.mass[nodes], state.positions[nodes]
    centre = mass @ points / mass.sum()
    moved = np.zeros_like(state.velocities)
    moved[nodes] = velocity + cross(angular_velocity, points - centre)
    own = model.free_nodes[np.isin(model.free_nodes, nodes)]
    state.velocities[own] = moved[own]
    for region in model.regions:
        if region.frame < 0 or not len(region.nodes) or region.nodes[0] not in nodes:
            continue
        arm = state.frame_positions[region.frame] - centre
        state.reduced_velocities[6 * region.frame :][:3] = velocity + cross(angular_velocity, arm)
        state.reduced_velocities[6 * region.frame + 3 :][:3] = angular_velocity
    model.place_regions(state)


def number_of(kind: str, name: str, names: Sequence[str]) -> int:
    """Index of a name.

    Raises:
        CommandError: it is not among the names.
    """
    if name not in names:
        raise CommandError(f"unknown {kind} {name!r}; {known_names(name, names)}")
    return list(names).index(name)
