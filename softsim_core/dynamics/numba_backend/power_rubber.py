"""Compiled rubber of two powers of stretches, of lines or of areas; see fem.materials.power_sum and ogden.

Mooney and Rivlin's law is one of these: the second powers of both.
"""

from __future__ import annotations

from math import exp, log
from typing import Any

import numpy as np
from numba import types

from softsim_core.arrays import Array
from softsim_core.dynamics.numba_backend.compile import kernel
from softsim_core.dynamics.numba_backend.lanes import Batch, Lanes, Triple
from softsim_core.dynamics.numba_backend.point_cells import (
    Given,
    Into,
    PointCells,
    deform,
    finish,
    press,
)
from softsim_core.dynamics.numba_backend.point_lanes import POINT_ROWS, put_cofactors
from softsim_core.dynamics.numba_backend.principal_lanes import (
    HESSIAN,
    add_volume,
    clamp_modes,
    put_modes,
    put_principal,
    put_stretches,
)
from softsim_core.dynamics.numba_backend.relaxation import Memory, remember
from softsim_core.fem.materials.mooney_rivlin import MooneyRivlin
from softsim_core.fem.materials.ogden import Ogden
from softsim_core.fem.materials.power_sum import LEAST_STRETCH
from softsim_core.linalg.compile import intrinsic
from softsim_core.linalg.simd import LANES

LEAST = LEAST_STRETCH**2
"""Squared stretch below which a power goes on as a parabola."""

NEAR = 0.1
"""Relative distance of two squared stretches, below which their divided difference is a series."""

TERMS = 17
"""Of that series: the next one is below rounding."""


def ogden_moduli(law: Ogden, p: Array) -> Array:
    """The slope of W at rest, and amplitude in [Pa] and exponent of each term, shape (m, 5)."""
    factor = p[:, 5]
    return np.column_stack([law.rest_moduli(p).slope, factor * p[:, 0], p[:, 1], factor * p[:, 2], p[:, 3]])


def mooney_rivlin_moduli(law: MooneyRivlin, p: Array) -> Array:
    """The same of C10 (I - 3) + C01 (II - 3)."""
    two, slope = np.full(len(p), 2.0), law.rest_moduli(p).slope
    return np.column_stack([slope, 4.0 * p[:, 3] * p[:, 0], two, 4.0 * p[:, 3] * p[:, 1], -two])


@kernel
def raise_stretches(points: Array, row: int, moduli: Array, place: int) -> None:
    """Rows 122 to 128 of a point: m / (2 n) x^(n/2 - 1) of both terms and the three squared stretches."""
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


def _divided(i: int, j: int, x: Triple, kept: Triple, power: Triple, bend: Triple, b: Lanes) -> Lanes:
    """The divided difference of the slope of the powers, between squared stretches i and j."""
    gap, apart = x[i] - x[j], kept[i] - kept[j]
    d, one = apart / kept[j], b * 0.0 + 1.0
    total = one
    for k in range(TERMS, 1, -1):
        total = (b + (1.0 - k)) * (1.0 / k) * d * total + 1.0
    near = d.size().below(NEAR)
    inner = ((power[i] - power[j]) / apart).where(near, power[j] / kept[j] * b * total)
    same = gap.equals(0.0)
    low = x[i].below(LEAST)
    share = (apart / gap).where(same, one.where(low, 0.0))
    return share * inner + (one - share) * bend[j].where(low, bend[i])


@intrinsic
def put_powers(typing: Any, points: Any, row: Any, moduli: Any, place: Any) -> Any:
    """Psi, h, a and b of W at a point, of its stretches and their powers."""
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
            kept, exponent = [each.at_least(LEAST) for each in x], alpha.size() * 0.5 - 1.0
            bend = [each * exponent / k for each, k in zip(power, kept, strict=True)]
            slope = [p + c * (each - k) for p, c, each, k in zip(power, bend, x, kept, strict=True)]
            pull = [each * y * 2.0 for each, y in zip(slope, own, strict=True)]
            along = [p * 2.0 + c * each * 4.0 for p, c, each in zip(slope, bend, x, strict=True)]
            # of areas, by the stretches of lines: dF_ij moves the cofactor ji by - s_l, and ii by s_l
            scale = [(zero + 1.0).where(areas, each * each) for each in s]
            turn = [zero.where(areas, each) for each in pull]
            for k in range(3):
                i, j = (k + 1) % 3, (k + 2) % 3
                gamma = _divided(i, j, x, kept, power, bend, exponent)
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
def power_points(batch: int, given: Given, cells: PointCells) -> None:
    """Stress and tangent of all points of a batch."""
    points, steps, weights, moduli = cells.room.points, cells.room.steps, cells.weights, cells.moduli
    batches = len(cells.cells.nodes)
    count, place = len(weights) // batches, batch * (len(moduli) // batches)
    deform(batch, given, cells)
    for q in range(count):
        put_cofactors(points, POINT_ROWS * q, steps, 9 * q)
    press(batch, cells)
    for q in range(count):
        row = POINT_ROWS * q
        put_stretches(points, row)
        raise_stretches(points, row, moduli, place)
        put_powers(points, row, moduli, place)
        add_volume(points, row, moduli, place, place + 2)
        if given.positive:
            clamp_modes(points, row)
        put_modes(points, row, weights, count * batch + q)


@kernel
def fill_powers(given: Given, cells: PointCells, into: Into) -> None:
    """Add forces and stiffness of all cells."""
    for batch in range(len(cells.cells.nodes)):
        power_points(batch, given, cells)
        finish(batch, given, cells, into)


@kernel
def remember_powers(given: Given, cells: PointCells, memory: Memory) -> None:
    """Take over in the memory of all cells what a step has done."""
    for batch in range(len(cells.cells.nodes)):
        power_points(batch, given, cells)
        remember(batch, cells, memory)
