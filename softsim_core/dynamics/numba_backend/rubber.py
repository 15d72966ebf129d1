"""Compiled rubber: laws that are a function of I_C = F : F; the formulas of fem.materials.first_invariant.

With the stress P = 2 psi' F + (p - s) cof F, the tangent is

    2 psi' I + 4 psi'' F F^T + (p - s) (cof F)' + a_p cof F cof F^T

and without negative eigenvalues in principal stretches; see principal_lanes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types

from softsim_core.arrays import Array
from softsim_core.dynamics.numba_backend.compile import kernel
from softsim_core.dynamics.numba_backend.lanes import Batch, Lanes, contraction
from softsim_core.dynamics.numba_backend.point_cells import (
    Given,
    Into,
    PointCells,
    deform,
    finish,
    press,
)
from softsim_core.dynamics.numba_backend.point_lanes import POINT_ROWS, flat, put_cofactors, put_tangent
from softsim_core.dynamics.numba_backend.principal_lanes import (
    HESSIAN,
    add_volume,
    clamp_modes,
    put_modes,
    put_principal,
    put_stretches,
)
from softsim_core.dynamics.numba_backend.relaxation import Memory, remember
from softsim_core.fem.materials.first_invariant import SeriesRubber
from softsim_core.linalg.compile import intrinsic


def rubber_moduli(law: SeriesRubber, p: Array) -> Array:
    """Slope s and the coefficients of psi, see SeriesRubber, in [Pa], shape (m, 5)."""
    return np.column_stack([law.rest_moduli(p).slope, law.series(p)])


def _psi_slopes(t: Lanes, numbers: list[Lanes]) -> tuple[Lanes, Lanes]:
    """2 psi' and 4 psi'' of the coefficients c1, c2, c3 and l."""
    c1, c2, c3, log = numbers
    over = (t * 0.0 + 1.0) / (t + 4.0)
    first = (c1 + t * (c2 * 2.0 + t * c3 * 3.0) - log * over) * 2.0
    return first, (c2 * 2.0 + t * c3 * 6.0 + log * over * over) * 4.0


@intrinsic
def put_rubber(typing: Any, points: Any, row: Any, weights: Any, weight: Any, moduli: Any, place: Any) -> Any:
    """Stress and tangent of a point; moduli: rows from `place` on, see PointCells."""
    integer = types.int64
    signature = types.void(points, integer, weights, integer, moduli, integer)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        b, kinds = Batch(context, builder), signature.args
        point = b.start(kinds[0], args[0], args[1])
        w = b.load(b.start(kinds[2], args[2], args[3]), 1)[0]
        at_point, _, rest, *series = b.load(b.start(kinds[4], args[4], args[5]), 7)
        f, sides = b.load_matrix(point), b.load_matrix(point, 18)
        first, second = (w * each for each in _psi_slopes(contraction(f, f) - 3.0, series))
        tension, turning = (w * (each - rest) for each in b.load(point, 2, 84))
        local, nine, across = w * at_point, flat(f), flat(sides)
        for k in range(9):
            b.put(point, 30 + k, first * nine[k] + tension * across[k])
        stretched, pressed = [second * each for each in nine], [local * each for each in across]
        turned = [turning * each for each in nine]

        def entry(one: int, other: int) -> Lanes:
            (i, j), (k, n) = divmod(one, 3), divmod(other, 3)
            total = stretched[one] * nine[other] + pressed[one] * across[other]
            if one == other:
                return total + first
            if i == k or j == n:
                return total
            third = turned[3 * (3 - i - k) + 3 - j - n]
            return total + third if ((i + 1) % 3 == k) == ((j + 1) % 3 == n) else total - third

        put_tangent(b, point, entry)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def put_rubber_modes(typing: Any, points: Any, row: Any, moduli: Any, place: Any) -> Any:
    """Psi, h, a and b of W at a point."""
    signature = types.void(points, types.int64, moduli, types.int64)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        b, kinds = Batch(context, builder), signature.args
        point = b.start(kinds[0], args[0], args[1])
        series = b.load(b.start(kinds[2], args[2], args[3]), 4, 3)
        s = b.load(point, 3, 104)
        first, second = _psi_slopes(s[0] * s[0] + s[1] * s[1] + s[2] * s[2] - 3.0, series)
        h = [second * s[i] * s[j] for i in range(3) for j in range(i, 3)]
        for k in range(3):
            h[HESSIAN[k][k]] = h[HESSIAN[k][k]] + first
        put_principal(b, point, [first * each for each in s], h, [first] * 3, [first] * 3)
        return context.get_dummy_value()

    return signature, generate


@kernel
def rubber_points(batch: int, given: Given, cells: PointCells) -> None:
    """Stress and tangent of all points of a batch."""
    points, steps, weights, moduli = cells.room.points, cells.room.steps, cells.weights, cells.moduli
    batches = len(cells.cells.nodes)
    count, place = len(weights) // batches, batch * (len(moduli) // batches)
    deform(batch, given, cells)
    for q in range(count):
        put_cofactors(points, POINT_ROWS * q, steps, 9 * q)
    press(batch, cells)
    for q in range(count):
        row, weight = POINT_ROWS * q, count * batch + q
        if given.positive:
            put_stretches(points, row)
            put_rubber_modes(points, row, moduli, place)
            add_volume(points, row, moduli, place, place + 2)
            clamp_modes(points, row)
            put_modes(points, row, weights, weight)
        else:
            put_rubber(points, row, weights, weight, moduli, place)


@kernel
def fill_rubber(given: Given, cells: PointCells, into: Into) -> None:
    """Add forces and stiffness of all cells."""
    for batch in range(len(cells.cells.nodes)):
        rubber_points(batch, given, cells)
        finish(batch, given, cells, into)


@kernel
def remember_rubber(given: Given, cells: PointCells, memory: Memory) -> None:
    """Take over in the memory of all cells what a step has done."""
    for batch in range(len(cells.cells.nodes)):
        rubber_points(batch, given, cells)
        remember(batch, cells, memory)
