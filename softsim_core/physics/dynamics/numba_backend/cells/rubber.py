"""Compiled rubber laws: functions of I_C = F : F, and sums of powers of the principal stretches.

With the stress P = 2 psi' F + (p - s) cof F, the tangent is

    2 psi' I + 4 psi'' F F^T + (p - s) (cof F)' + a_p cof F cof F^T

The tangent without negative eigenvalues is computed in principal stretches; see lanes.

The Mooney-Rivlin law is a sum of powers: the second powers of line and area stretches.
"""

from __future__ import annotations

from math import exp, log
from typing import Any

import numpy as np
from numba import types

from softsim_core.base import Array
from softsim_core.physics.dynamics.numba_backend import kernel
from softsim_core.physics.dynamics.numba_backend.cells.lanes import (
    HESSIAN,
    POINT_ROWS,
    Batch,
    Lanes,
    Triple,
    add_volume,
    clamp_modes,
    contraction,
    flat,
    put_cofactors,
    put_modes,
    put_principal,
    put_stretches,
    put_tangent,
)
from softsim_core.physics.dynamics.numba_backend.cells.points import (
    CellInputs,
    CellOutputs,
    Memory,
    PointCells,
    deform,
    finish,
    press,
    remember,
)
from softsim_core.physics.fem.materials import LEAST_STRETCH, MooneyRivlin, Ogden, SeriesRubber
from softsim_core.physics.linalg import LANES, intrinsic


def rubber_moduli(law: SeriesRubber, p: Array) -> Array:
    """Return the slope s and the coefficients of psi, see SeriesRubber, in [Pa], shape (m, 5)."""
    return np.column_stack([law.rest_moduli(p).slope, law.series(p)])


def _psi_slopes(t: Lanes, numbers: list[Lanes]) -> tuple[Lanes, Lanes]:
    """Return 2 psi' and 4 psi'' for the coefficients c1, c2, c3 and l."""
    c1, c2, c3, log = numbers
    over = (t * 0.0 + 1.0) / (t + 4.0)
    first = (c1 + t * (c2 * 2.0 + t * c3 * 3.0) - log * over) * 2.0
    return first, (c2 * 2.0 + t * c3 * 6.0 + log * over * over) * 4.0


@intrinsic
def put_rubber(typing: Any, points: Any, row: Any, weights: Any, weight: Any, moduli: Any, place: Any) -> Any:
    """Write stress and tangent of a point; `moduli` has rows from `place` on, see PointCells."""
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
    """Write psi, h, a and b of W at a point."""
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
def rubber_points(batch: int, inputs: CellInputs, cells: PointCells) -> None:
    """Compute stress and tangent at all points of a batch."""
    points, steps, weights, moduli = cells.buffers.points, cells.buffers.steps, cells.weights, cells.moduli
    batches = len(cells.cells.nodes)
    count, place = len(weights) // batches, batch * (len(moduli) // batches)
    deform(batch, inputs, cells)
    for q in range(count):
        put_cofactors(points, POINT_ROWS * q, steps, 9 * q)
    press(batch, cells)
    for q in range(count):
        row, weight = POINT_ROWS * q, count * batch + q
        if inputs.positive:
            put_stretches(points, row)
            put_rubber_modes(points, row, moduli, place)
            add_volume(points, row, moduli, place, place + 2)
            clamp_modes(points, row)
            put_modes(points, row, weights, weight)
        else:
            put_rubber(points, row, weights, weight, moduli, place)


@kernel
def fill_rubber(inputs: CellInputs, cells: PointCells, into: CellOutputs) -> None:
    """Add forces and stiffness of all cells."""
    for batch in range(len(cells.cells.nodes)):
        rubber_points(batch, inputs, cells)
        finish(batch, inputs, cells, into)


@kernel
def remember_rubber(inputs: CellInputs, cells: PointCells, memory: Memory) -> None:
    """Advance the memory of all cells after a step."""
    for batch in range(len(cells.cells.nodes)):
        rubber_points(batch, inputs, cells)
        remember(batch, cells, memory)


LEAST = LEAST_STRETCH**2
"""Squared stretch below which a power continues as a parabola."""

NEAR = 0.1
"""Relative distance of two squared stretches below which their divided difference is a series."""

TERMS = 17
"""Number of terms of that series: the next one is below rounding."""


def ogden_moduli(law: Ogden, p: Array) -> Array:
    """Return the slope of W at rest, and amplitude in [Pa] and exponent of each term, shape (m, 5)."""
    factor = p[:, 5]
    return np.column_stack([law.rest_moduli(p).slope, factor * p[:, 0], p[:, 1], factor * p[:, 2], p[:, 3]])


def mooney_rivlin_moduli(law: MooneyRivlin, p: Array) -> Array:
    """Return the moduli of `ogden_moduli` for C10 (I - 3) + C01 (II - 3)."""
    two, slope = np.full(len(p), 2.0), law.rest_moduli(p).slope
    return np.column_stack([slope, 4.0 * p[:, 3] * p[:, 0], two, 4.0 * p[:, 3] * p[:, 1], -two])


@kernel
def raise_stretches(points: Array, row: int, moduli: Array, place: int) -> None:
    """Write rows 122 to 128 of a point: m / (2 n) x^(n/2 - 1) of both terms at three squared stretches."""
    for lane in range(LANES):
        s0, s1, s2 = points[row + 104, lane], points[row + 105, lane], points[row + 106, lane]
        for term in range(2):
            m, alpha = moduli[place + 3 + 2 * term, lane], moduli[place + 4 + 2 * term, lane]
            n = abs(alpha)
            for k in range(3):
                own = s0 if k == 0 else s1 if k == 1 else s2
                if alpha < 0.0:
                    own = s1 * s2 if k == 0 else s2 * s0 if k == 1 else s0 * s1
                power = 0.0
                if m != 0.0:
                    power = m / (2.0 * n) * exp((0.5 * n - 1.0) * log(max(own * own, LEAST)))
                points[row + 122 + 3 * term + k, lane] = power


def _compute_divided_difference(
    i: int, j: int, x: Triple, bounded: Triple, power: Triple, bend: Triple, b: Lanes
) -> Lanes:
    """Return the divided difference of the powers' slope between squared stretches i and j."""
    gap, apart = x[i] - x[j], bounded[i] - bounded[j]
    d, one = apart / bounded[j], b * 0.0 + 1.0
    total = one
    for k in range(TERMS, 1, -1):
        total = (b + (1.0 - k)) * (1.0 / k) * d * total + 1.0
    near = d.size().below(NEAR)
    inner = ((power[i] - power[j]) / apart).where(near, power[j] / bounded[j] * b * total)
    same = gap.equals(0.0)
    low = x[i].below(LEAST)
    share = (apart / gap).where(same, one.where(low, 0.0))
    return share * inner + (one - share) * bend[j].where(low, bend[i])


@intrinsic
def put_powers(typing: Any, points: Any, row: Any, moduli: Any, place: Any) -> Any:
    """Write psi, h, a and b of W at a point from its stretches and their powers."""
    signature = types.void(points, types.int64, moduli, types.int64)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        b, kinds = Batch(context, builder), signature.args
        point = b.start(kinds[0], args[0], args[1])
        numbers = b.load(b.start(kinds[2], args[2], args[3]), 4, 3)
        s = b.load(point, 3, 104)
        zero = s[0] * 0.0
        sides = [s[1] * s[2], s[2] * s[0], s[0] * s[1]]
        psi, h, a, twist = [zero] * 3, [zero] * 6, [zero] * 3, [zero] * 3
        for term in range(2):
            alpha = numbers[2 * term + 1]
            areas, power = alpha.below(0.0), b.load(point, 3, 122 + 3 * term)
            own = [x.where(areas, y) for x, y in zip(s, sides, strict=True)]
            x = [each * each for each in own]
            bounded, exponent = [each.at_least(LEAST) for each in x], alpha.size() * 0.5 - 1.0
            bend = [each * exponent / k for each, k in zip(power, bounded, strict=True)]
            slope = [p + c * (each - k) for p, c, each, k in zip(power, bend, x, bounded, strict=True)]
            pull = [each * y * 2.0 for each, y in zip(slope, own, strict=True)]
            along = [p * 2.0 + c * each * 4.0 for p, c, each in zip(slope, bend, x, strict=True)]
            # for areas, by the line stretches: dF_ij changes the cofactor ji by - s_l, and ii by s_l
            scale = [(zero + 1.0).where(areas, each * each) for each in s]
            turn = [zero.where(areas, each) for each in pull]
            for k in range(3):
                i, j = (k + 1) % 3, (k + 2) % 3
                gamma = _compute_divided_difference(i, j, x, bounded, power, bend, exponent)
                both, sum_, gap = slope[i] + slope[j], own[i] + own[j], own[i] - own[j]
                a[k] = a[k] + (both + sum_ * sum_ * gamma) * scale[k] - turn[k]
                twist[k] = twist[k] + (both + gap * gap * gamma) * scale[k] + turn[k]
                psi[k] = psi[k] + pull[k].where(areas, pull[i] * s[j] + pull[j] * s[i])
                own_second = along[i] * s[j] * s[j] + along[j] * s[i] * s[i]
                h[HESSIAN[k][k]] = h[HESSIAN[k][k]] + along[k].where(areas, own_second)
                mixed = along[k] * s[i] * s[j] + pull[k]  # of i and j, by the area k
                h[HESSIAN[i][j]] = h[HESSIAN[i][j]] + zero.where(areas, mixed)
        put_principal(b, point, psi, h, a, twist)
        return context.get_dummy_value()

    return signature, generate


@kernel
def power_points(batch: int, inputs: CellInputs, cells: PointCells) -> None:
    """Compute stress and tangent at all points of a batch."""
    points, steps, weights, moduli = cells.buffers.points, cells.buffers.steps, cells.weights, cells.moduli
    batches = len(cells.cells.nodes)
    count, place = len(weights) // batches, batch * (len(moduli) // batches)
    deform(batch, inputs, cells)
    for q in range(count):
        put_cofactors(points, POINT_ROWS * q, steps, 9 * q)
    press(batch, cells)
    for q in range(count):
        row = POINT_ROWS * q
        put_stretches(points, row)
        raise_stretches(points, row, moduli, place)
        put_powers(points, row, moduli, place)
        add_volume(points, row, moduli, place, place + 2)
        if inputs.positive:
            clamp_modes(points, row)
        put_modes(points, row, weights, count * batch + q)


@kernel
def fill_powers(inputs: CellInputs, cells: PointCells, into: CellOutputs) -> None:
    """Add forces and stiffness of all cells."""
    for batch in range(len(cells.cells.nodes)):
        power_points(batch, inputs, cells)
        finish(batch, inputs, cells, into)


@kernel
def remember_powers(inputs: CellInputs, cells: PointCells, memory: Memory) -> None:
    """Advance the memory of all cells after a step."""
    for batch in range(len(cells.cells.nodes)):
        power_points(batch, inputs, cells)
        remember(batch, cells, memory)
