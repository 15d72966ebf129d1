"""The kinds of actuators that have compiled kernels, as the compiled step calls them.

A kind that has none is evaluated in NumPy before and after the compiled part of a step. A kind that gets some
adds its arrays to CompiledKinds and its kernels to the functions below. Rows of the compiled kinds come
first, in the order of the fields of CompiledKinds.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softsim_core.actuation.actuators import Actuators
from softsim_core.actuation.cable.cables import Cables
from softsim_core.actuation.cable.layout import CableArrays
from softsim_core.actuation.chamber.chambers import ChamberArrays, Chambers
from softsim_core.actuation.compiled.cables import fill_cables, measure_cables
from softsim_core.actuation.compiled.chambers import fill_chambers, measure_chambers
from softsim_core.actuation.compiled.compile import kernel
from softsim_core.arrays import Array


class CompiledKinds(NamedTuple):
    """Arrays of each kind that has compiled kernels."""

    cables: CableArrays
    chambers: ChamberArrays


def compiled_kinds(actuators: Actuators) -> tuple[CompiledKinds, int]:
    """What the kernels need of a model's actuators, and how many of them they evaluate: the first ones."""
    cables, chambers, count = _no_cables(), Chambers([]).compiled(0, 0), 0
    for group, rows, entries in actuators.spans():
        if isinstance(group, Cables) and not count:
            cables = group.compiled()
        elif isinstance(group, Chambers):
            chambers = group.compiled(rows.start, entries.start)
        else:
            break
        count = rows.stop
    return CompiledKinds(cables, chambers), count


def _no_cables() -> CableArrays:
    index, none = np.zeros(0, np.int64), np.zeros(0)
    nodes, points = np.zeros((0, 4), np.int64), np.zeros((0, 3))
    return CableArrays(
        np.zeros(1, np.int64), nodes, np.zeros((0, 4)), index, points, *(index,) * 4, none, points, points
    )


@kernel
def measure(positions: Array, origins: Array, rotations: Array, kinds: CompiledKinds, value: Array) -> None:
    """Coordinates of the compiled kinds into the first of `value` (c,).

    Args:
        positions: Node positions in [m], shape (n, 3).
        origins: Origins in [m] of the frames that joints move, shape (j, 3).
        rotations: Rotations of these frames, shape (j, 3, 3).
        kinds: The compiled kinds.
        value: Filled, one number per actuator.
    """
    measure_cables(positions, origins, rotations, kinds.cables, value)
    measure_chambers(positions, kinds.chambers, value)


@kernel
def fill(angular: Array, linear: Array, origin: Array, kinds: CompiledKinds, coefficient: Array) -> None:
    """Entries of the rows of the compiled kinds into the first of `coefficient` (k, 3), after `measure`.

    Args:
        angular: With `linear` and `origin` the motion_subspace of the reduced coordinates, shape (b, 3) each.
        linear: See `angular`.
        origin: See `angular`.
        kinds: The compiled kinds.
        coefficient: Filled.
    """
    fill_cables(angular, linear, origin, kinds.cables, coefficient)
    fill_chambers(kinds.chambers, coefficient)
