"""Compiled kernels of chambers: the twin of actuation.chamber.chamber."""

from __future__ import annotations

from softsim_core.actuation.chamber.chambers import ChamberArrays
from softsim_core.actuation.compiled.compile import kernel
from softsim_core.arrays import Array


@kernel
def measure_chambers(positions: Array, chambers: ChamberArrays, value: Array) -> None:
    """By how much the volumes have grown in [m^3] into `value`, and their rows into `chambers`.

    For the arguments see compiled.kinds.
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
    """Entries of their rows into `coefficient` (k, 3), after `measure_chambers`; see compiled.kinds."""
    begin, found = chambers.begin[0], chambers.rows
    for e in range(len(found)):
        for i in range(3):
            coefficient[begin + e, i] = found[e, i]
