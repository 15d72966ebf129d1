"""Compiled kernels of cables: the twin of actuation.cable.cables."""

from __future__ import annotations

from math import sqrt

from softsim_core.actuation.cable.layout import IN_BODY, IN_WORLD, CableArrays
from softsim_core.actuation.compiled.compile import kernel
from softsim_core.arrays import Array


@kernel
def measure_cables(
    positions: Array, origins: Array, rotations: Array, cables: CableArrays, value: Array
) -> None:
    """Displacements of the cables in [m] into `value` (c,), their points and pulls into `cables`.

    For the arguments see compiled.kinds.
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
    """Entries of the cables' rows into `coefficient` (k, 3), after `measure_cables`; see compiled.kinds."""
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
