"""Compiled kernels of actuators, kind by kind, for the compiled step.

A kind without kernels is evaluated in NumPy before and after the compiled part of a step. To compile a kind,
add its arrays to CompiledKinds and its kernels to the functions below. Rows of the compiled kinds come first,
in the order of the fields of CompiledKinds.
"""

from __future__ import annotations

from math import sqrt
from pathlib import Path
from typing import NamedTuple

import numpy as np

from softsim_core.base import Array
from softsim_core.physics.actuation import Actuators
from softsim_core.physics.actuation.cable import IN_BODY, IN_WORLD, CableArrays, Cables
from softsim_core.physics.actuation.chamber import ChamberArrays, Chambers
from softsim_core.physics.kernels import Compiler

compiler = Compiler(Path(__file__).parent)
kernel = compiler.kernel
"""Decorator of the actuators' kernels, compiled or interpreted as `Compiler` decides."""


@kernel
def measure_cables(
    positions: Array, origins: Array, rotations: Array, cables: CableArrays, value: Array
) -> None:
    """Write the displacements of the cables in [m] into `value` (c,), their points and pulls into `cables`.

    For the arguments see `measure`.
    """
    points, pulls = cables.points, cables.pulls
    for p in range(len(points)):
        carrier = cables.carrier[p]
        for i in range(3):
            pulls[p, i] = 0.0
            if carrier == IN_BODY:
                points[p, i] = 0.0
                for k in range(4):
                    points[p, i] += cables.weights[p, k] * positions[cables.nodes[p, k], i]
            elif carrier == IN_WORLD:
                points[p, i] = cables.local[p, i]
            else:
                points[p, i] = origins[carrier, i]
                for d in range(3):
                    points[p, i] += rotations[carrier, i, d] * cables.local[p, d]
    for c in range(len(cables.rest_length)):
        value[c] = cables.rest_length[c]
        for p in range(cables.first[c], cables.first[c + 1] - 1):
            square = 0.0
            for i in range(3):
                square += (points[p + 1, i] - points[p, i]) ** 2
            length = sqrt(square)
            value[c] -= length
            for i in range(3):
                unit = (points[p + 1, i] - points[p, i]) / max(length, 1e-12)
                pulls[p, i] += unit
                pulls[p + 1, i] -= unit


@kernel
def fill_cables(
    angular: Array, linear: Array, origin: Array, cables: CableArrays, coefficient: Array
) -> None:
    """Write the entries of the cables' rows into `coefficient` (k, 3), after `measure_cables`; see `fill`."""
    for p in range(len(cables.points)):
        for k in range(4):
            for i in range(3):
                coefficient[cables.entry[p] + k, i] = cables.weights[p, k] * cables.pulls[p, i]
    for m in range(len(cables.levers)):
        b, p = cables.lever_unknowns[m], cables.lever_points[m]
        total = 0.0
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            turned = angular[b, j] * (cables.points[p, k] - origin[b, k])
            turned -= angular[b, k] * (cables.points[p, j] - origin[b, j])
            total += cables.pulls[p, i] * (turned + linear[b, i])
        coefficient[cables.levers[m], 0] = total


@kernel
def measure_chambers(positions: Array, chambers: ChamberArrays, value: Array) -> None:
    """Write the growth of the volumes in [m^3] into `value`, and their rows into `chambers`.

    For the arguments see `measure`.
    """
    x, slopes, found = chambers.corners, chambers.slopes, chambers.rows
    found[:] = 0.0
    for c in range(len(chambers.row)):
        size, volume = chambers.size[c], 0.0
        pairs, shares = chambers.pairs[c], chambers.shares[c]
        for f in range(chambers.first[c], chambers.first[c + 1]):
            for a in range(size):
                for i in range(3):
                    x[a, i] = positions[chambers.nodes[f, a], i] - chambers.middle[c, i]
                    slopes[a, i] = 0.0
            for p in range(size * (size - 1) // 2):
                one, two = pairs[p, 0], pairs[p, 1]
                across_x = x[one, 1] * x[two, 2] - x[one, 2] * x[two, 1]
                across_y = x[one, 2] * x[two, 0] - x[one, 0] * x[two, 2]
                across_z = x[one, 0] * x[two, 1] - x[one, 1] * x[two, 0]
                for a in range(size):
                    slopes[a, 0] += shares[p, a] * across_x
                    slopes[a, 1] += shares[p, a] * across_y
                    slopes[a, 2] += shares[p, a] * across_z
            for a in range(size):
                entry = chambers.entry[f, a]
                for i in range(3):
                    volume += x[a, i] * slopes[a, i]
                    found[entry, i] += slopes[a, i]
        value[chambers.row[c]] = volume / 3.0 - chambers.at_rest[c]


@kernel
def fill_chambers(chambers: ChamberArrays, coefficient: Array) -> None:
    """Write the entries of the chambers' rows into `coefficient` (k, 3), after `measure_chambers`.

    See `fill`.
    """
    begin, found = chambers.begin[0], chambers.rows
    for e in range(len(found)):
        for i in range(3):
            coefficient[begin + e, i] = found[e, i]


class CompiledKinds(NamedTuple):
    """Arrays of each kind that has compiled kernels."""

    cables: CableArrays
    chambers: ChamberArrays


def compiled_kinds(actuators: Actuators) -> tuple[CompiledKinds, int]:
    """Return the kernels' arrays for a model's actuators, and how many they evaluate: the first ones."""
    cables, chambers, count = _no_cables(), Chambers([]).to_arrays(0, 0), 0
    for group, rows, entries in actuators.spans():
        if isinstance(group, Cables) and not count:
            cables = group.to_arrays()
        elif isinstance(group, Chambers):
            chambers = group.to_arrays(rows.start, entries.start)
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
    """Write the coordinates of the compiled kinds into the first entries of `value` (c,).

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
    """Write the entries of the compiled kinds' rows into the first of `coefficient` (k, 3), after `measure`.

    Args:
        angular: With `linear` and `origin` the motion subspace of the reduced coordinates, shape (b, 3) each.
        linear: See `angular`.
        origin: See `angular`.
        kinds: The compiled kinds.
        coefficient: Filled.
    """
    fill_cables(angular, linear, origin, kinds.cables, coefficient)
    fill_chambers(kinds.chambers, coefficient)
