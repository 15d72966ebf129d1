"""Laws with compiled stress and tangent at a point, and the moduli of their kernels.

The laws of the package compute LANES points at once. A law of one's own is compiled from its function
`stress_and_tangent`, which computes one point after the other.

Rubber whose energy is a function psi of I_C = F : F has the stress P = 2 psi' F + (p - s) cof F and the
tangent

    2 psi' I + 4 psi'' F F^T + (p - s) (cof F)' + a_p cof F cof F^T

All other laws, and this one where its tangent must not have negative eigenvalues, are computed in principal
stretches; see stretches. Ogden rubber is a sum of powers of them, and so is Mooney-Rivlin rubber: the second
powers of line and area stretches. Corotational cells have theta = s1 + s2 + s3 - 3 and psi_i = 2 mu (s_i - 1)
+ p. Of their tangent only the rotational modes can be negative: b_l = 2 mu - 2 gamma / (s_i + s_j), where
gamma is 2 mu - p.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from math import exp, log
from typing import Any, NamedTuple

import numpy as np

from softsim_core.base import Array, IndexArray
from softsim_core.physics.dynamics.numba_backend.batches import (
    CellBatches,
    Triple,
    allocate_aligned,
    at_least,
    choose,
    contraction,
    difference,
    dot,
    in_lanes,
    matrix_at,
    minus,
    plus,
    product,
    put_matrix,
    scaled,
    size,
    times,
    triple_at,
)
from softsim_core.physics.dynamics.numba_backend.layout import kernel
from softsim_core.physics.dynamics.numba_backend.points import (
    DEFORMATION,
    DILATATION,
    DILATATION_RATE,
    DILATATION_SLOPE,
    FOUND_DILATATION,
    POINT_ROWS,
    PRESSURE,
    RATE,
    STRESS,
    TANGENT,
    UPPER,
    CellInputs,
    CellOutputs,
    Memory,
    PointCells,
    allocate_buffers,
    deform,
    deformation_gradients,
    fill_given,
    finish_batch,
    press,
    put_cofactors,
)
from softsim_core.physics.dynamics.numba_backend.stretches import (
    FIRST_DIRECTIONS,
    POWERS,
    SECOND_DIRECTIONS,
    STRETCHES,
    add_volume,
    clamp_modes,
    nearest_rotation,
    put_modes,
    put_principal,
    put_stretches,
)
from softsim_core.physics.fem import ElementGroup, mean_volume_law, split_bulk
from softsim_core.physics.fem.materials import (
    LEAST_STRETCH,
    SMALLEST_VOLUME,
    Corotational,
    Material,
    MooneyRivlin,
    Ogden,
    Relaxing,
    SeriesRubber,
    VolumetricMaterial,
    clamp_tangent,
    compile_points,
    lame,
    law_within,
)
from softsim_core.physics.kernels import OneSignature
from softsim_core.physics.linalg import LANES, part, put, row, where


def rubber_moduli(law: SeriesRubber, p: Array) -> Array:
    """Return the slope s and the coefficients of psi, see SeriesRubber, in [Pa], shape (m, 5)."""
    return np.column_stack([law.rest_moduli(p).slope, law.series(p)])


@part
def psi_slopes(t: Any, moduli: Array, series: int) -> tuple[Any, Any]:
    """Return 2 psi' and 4 psi'' for the coefficients c1, c2, c3 and l in rows from `series` on."""
    c1, c2, c3 = triple_at(moduli, series)
    log, inverse = row(moduli, series + 3), 1.0 / (t + 4.0)
    first = c1 + t * (2.0 * c2 + 3.0 * t * c3) - log * inverse
    return 2.0 * first, 4.0 * (2.0 * c2 + 6.0 * t * c3 + log * inverse * inverse)


@part
def put_rubber(points: Array, point: int, w: Any, moduli: Array, place: int) -> None:
    """Write stress and tangent of a point of weight w; `moduli` has rows from `place` on, see PointCells."""
    at_point, rest = row(moduli, place), row(moduli, place + 2)
    f = matrix_at(points, point + DEFORMATION)
    first, second = psi_slopes(contraction(f, f) - 3.0, moduli, place + 3)
    first, second, local = w * first, w * second, w * at_point
    tension = w * (row(points, point + PRESSURE) - rest)
    turning = w * (row(points, point + PRESSURE + 1) - rest)
    entry = point + TANGENT
    for one in range(9):
        own, side = row(points, point + DEFORMATION + one), row(points, point + DILATATION_SLOPE + one)
        put(points, point + STRESS + one, first * own + tension * side)
        stretched, pressed = second * own, local * side
        for other in range(one, 9):
            across = row(points, point + DILATATION_SLOPE + other)
            total = stretched * row(points, point + DEFORMATION + other) + pressed * across
            put(points, entry, total + first if one == other else total)
            entry += 1
    for i in range(3):
        for k in range(i + 1, 3):
            third, factor = point + DEFORMATION + 3 * (3 - i - k), turning if k == i + 1 else -turning
            for j in range(3):
                before, after = (j + 2) % 3, (j + 1) % 3
                one, other = UPPER[3 * i + j, 3 * k + after], UPPER[3 * i + j, 3 * k + before]
                add_to_row(points, point + TANGENT + one, factor * row(points, third + before))
                add_to_row(points, point + TANGENT + other, -factor * row(points, third + after))


@part
def add_to_row(points: Array, index: int, a: Any) -> None:
    """Add to a row."""
    put(points, index, row(points, index) + a)


@part
def put_rubber_modes(points: Array, point: int, moduli: Array, place: int) -> None:
    """Write psi, h, a and b of W at a point."""
    s = triple_at(points, point + STRETCHES)
    first, second = psi_slopes(dot(s, s) - 3.0, moduli, place + 3)
    h0, h1, h2 = scaled(second * s[0], s), scaled(second * s[1], s), scaled(second * s[2], s)
    h = ((h0[0] + first, h0[1], h0[2]), (h1[0], h1[1] + first, h1[2]), (h2[0], h2[1], h2[2] + first))
    put_principal(points, point, scaled(first, s), h, (first, first, first), (first, first, first))


@kernel
def rubber_cells(
    inputs: CellInputs, cells: PointCells, into: CellOutputs | None, memory: Memory | None
) -> None:
    """Compute stress and tangent of rubber at all points, and finish all cells."""
    points, steps, weights, moduli = cells.buffers.points, cells.buffers.steps, cells.weights, cells.moduli
    batches = len(cells.cells.nodes)
    count, size = len(weights) // batches, len(moduli) // batches
    for batch in range(batches):
        place = size * batch
        deform(batch, inputs, cells)
        for q in range(count):
            put_cofactors(points, POINT_ROWS * q, steps, 9 * q)
        press(batch, cells)
        for q in range(count):
            point, w = POINT_ROWS * q, row(weights, count * batch + q)
            if inputs.positive:
                put_stretches(points, point)
                put_rubber_modes(points, point, moduli, place)
                add_volume(points, point, row(moduli, place), row(moduli, place + 2))
                clamp_modes(points, point)
                put_modes(points, point, w, cells.buffers.modes)
            else:
                put_rubber(points, point, w, moduli, place)
        finish_batch(batch, inputs, cells, into, memory)


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
def raise_stretches(points: Array, point: int, moduli: Array, place: int) -> None:
    """Write the powers of a point: m / (2 n) x^(n/2 - 1) of both terms at three squared stretches."""
    for lane in range(LANES):
        for term in range(2):
            m, alpha = moduli[place + 3 + 2 * term, lane], moduli[place + 4 + 2 * term, lane]
            n = abs(alpha)
            for k in range(3):
                own = points[point + STRETCHES + k, lane]
                if alpha < 0.0:
                    i, j = point + STRETCHES + (k + 1) % 3, point + STRETCHES + (k + 2) % 3
                    own = points[i, lane] * points[j, lane]
                power = 0.0
                if m != 0.0:
                    power = m / (2.0 * n) * exp((0.5 * n - 1.0) * log(max(own * own, LEAST)))
                points[point + POWERS + 3 * term + k, lane] = power


@part
def divided_difference(one: Any, other: Any, b: Any) -> Any:
    """Return the divided difference of the powers' slope between two squared stretches.

    `one` and `other` are the squared stretch x, the larger of x and LEAST, its power, and the slope of that.
    """
    (x, x_bounded, x_power, x_bend), (y, y_bounded, y_power, y_bend) = one, other
    gap, apart = x - y, x_bounded - y_bounded
    d = apart / y_bounded
    total = 0.0 * b + 1.0
    for k in range(TERMS, 1, -1):
        total = (b + (1.0 - k)) * (1.0 / k) * d * total + 1.0
    inner = where(size(d) < NEAR, y_power / y_bounded * b * total, (x_power - y_power) / apart)
    is_low = x < LEAST
    share = where(gap == 0.0, where(is_low, 0.0, 1.0), apart / gap)
    return share * inner + (1.0 - share) * where(is_low, x_bend, y_bend)


@part
def put_powers(points: Array, point: int, moduli: Array, place: int) -> None:
    """Write psi, h, a and b of W at a point from its stretches and their powers."""
    s = triple_at(points, point + STRETCHES)
    first = powers_of_a_term(s, row(moduli, place + 3 + 1), triple_at(points, point + POWERS))
    second = powers_of_a_term(s, row(moduli, place + 3 + 3), triple_at(points, point + POWERS + 3))
    h = (plus(first[1][0], second[1][0]), plus(first[1][1], second[1][1]), plus(first[1][2], second[1][2]))
    a, b = plus(first[2], second[2]), plus(first[3], second[3])
    put_principal(points, point, plus(first[0], second[0]), h, a, b)


@part
def pair_of_modes(is_area: Any, s: Any, both: Any, x: Any, y: Any, difference: Any, pull: Any) -> Any:
    """Return a and b of the axes beside one with the stretch s.

    `both` is the sum of the slopes at the two own stretches x and y, `difference` their divided difference.
    """
    scale, turn = where(is_area, s * s, 1.0), where(is_area, pull, 0.0)
    along, gap = x + y, x - y
    a = (both + along * along * difference) * scale - turn
    return a, (both + gap * gap * difference) * scale + turn


@part
def powers_of_a_term(s: Triple, alpha: Any, power: Triple) -> Any:
    """Return psi, h, a and b of a term with the exponent alpha, negative for area stretches."""
    is_area = alpha < 0.0
    areas = (s[1] * s[2], s[2] * s[0], s[0] * s[1])
    own = choose(is_area, areas, s)
    x = product(own, own)
    k = (at_least(x[0], LEAST), at_least(x[1], LEAST), at_least(x[2], LEAST))
    exponent = 0.5 * size(alpha) - 1.0
    c = (power[0] * exponent / k[0], power[1] * exponent / k[1], power[2] * exponent / k[2])
    slope = plus(power, product(c, minus(x, k)))
    pull, along = scaled(2.0, product(slope, own)), plus(scaled(2.0, slope), scaled(4.0, product(c, x)))
    first, second = (x[0], k[0], power[0], c[0]), (x[1], k[1], power[1], c[1])
    third = (x[2], k[2], power[2], c[2])
    d0 = divided_difference(second, third, exponent)
    d1 = divided_difference(third, first, exponent)
    d2 = divided_difference(first, second, exponent)
    a0, b0 = pair_of_modes(is_area, s[0], slope[1] + slope[2], own[1], own[2], d0, pull[0])
    a1, b1 = pair_of_modes(is_area, s[1], slope[2] + slope[0], own[2], own[0], d1, pull[1])
    a2, b2 = pair_of_modes(is_area, s[2], slope[0] + slope[1], own[0], own[1], d2, pull[2])
    # an area stretch k changes by s_i and s_j: dF_ij changes the cofactor ji by - s_l, and ii by s_l
    psi = choose(
        is_area,
        (pull[1] * s[2] + pull[2] * s[1], pull[2] * s[0] + pull[0] * s[2], pull[0] * s[1] + pull[1] * s[0]),
        pull,
    )
    h00 = where(is_area, along[1] * s[2] * s[2] + along[2] * s[1] * s[1], along[0])
    h11 = where(is_area, along[2] * s[0] * s[0] + along[0] * s[2] * s[2], along[1])
    h22 = where(is_area, along[0] * s[1] * s[1] + along[1] * s[0] * s[0], along[2])
    h12 = where(is_area, along[0] * s[1] * s[2] + pull[0], 0.0)
    h02 = where(is_area, along[1] * s[2] * s[0] + pull[1], 0.0)
    h01 = where(is_area, along[2] * s[0] * s[1] + pull[2], 0.0)
    return psi, ((h00, h01, h02), (h01, h11, h12), (h02, h12, h22)), (a0, a1, a2), (b0, b1, b2)


@kernel
def power_cells(
    inputs: CellInputs, cells: PointCells, into: CellOutputs | None, memory: Memory | None
) -> None:
    """Compute stress and tangent of a sum of powers at all points, and finish all cells."""
    points, steps, weights, moduli = cells.buffers.points, cells.buffers.steps, cells.weights, cells.moduli
    batches = len(cells.cells.nodes)
    count, size = len(weights) // batches, len(moduli) // batches
    for batch in range(batches):
        place = size * batch
        deform(batch, inputs, cells)
        for q in range(count):
            put_cofactors(points, POINT_ROWS * q, steps, 9 * q)
        press(batch, cells)
        for q in range(count):
            point, w = POINT_ROWS * q, row(weights, count * batch + q)
            put_stretches(points, point)
            raise_stretches(points, point, moduli, place)
            put_powers(points, point, moduli, place)
            add_volume(points, point, row(moduli, place), row(moduli, place + 2))
            if inputs.positive:
                clamp_modes(points, point)
            put_modes(points, point, w, cells.buffers.modes)
        finish_batch(batch, inputs, cells, into, memory)


def corotational_moduli(law: Corotational, p: Array) -> Array:
    """Return mu in [Pa], shape (m, 1)."""
    return np.asarray(lame(p)[1][:, None])


@part
def put_rotation(points: Array, point: int) -> None:
    """Write the rotation and theta = tr S - 3 of a point from its stretches."""
    u, v = matrix_at(points, point + FIRST_DIRECTIONS), matrix_at(points, point + SECOND_DIRECTIONS)
    s = triple_at(points, point + STRETCHES)
    r = (times(v, u[0]), times(v, u[1]), times(v, u[2]))
    theta = s[0] + s[1] + s[2] - 3.0
    put_matrix(points, point + DILATATION_SLOPE, r)
    put(points, point + DILATATION, theta)
    put(points, point + FOUND_DILATATION, theta)
    put(points, point + DILATATION_RATE, contraction(r, matrix_at(points, point + RATE)))


@part
def put_found(points: Array, point: int, moved: Array, place: int) -> None:
    """Write theta as the last solve found it.

    `moved` has the gradient of the solve's displacement from row `place` on.
    """
    f = matrix_at(points, point + DEFORMATION)
    r = nearest_rotation(difference(f, matrix_at(moved, place)))
    put(points, point + FOUND_DILATATION, contraction(r, f) - 3.0)


@part
def put_corotational(points: Array, point: int, moduli: Array, place: int, positive: bool) -> None:
    """Write psi, h, a and b of a point; `moduli` has a_p, one more, and mu in rows from `place` on."""
    at_point, mu = row(moduli, place), row(moduli, place + 2)
    s = triple_at(points, point + STRETCHES)
    now, found = row(points, point + PRESSURE), row(points, point + PRESSURE + 1)
    double = 2.0 * mu
    gamma, sums = double - found, (s[1] + s[2], s[2] + s[0], s[0] + s[1])
    within = (gamma < mu * sums[0], gamma < mu * sums[1], gamma < mu * sums[2])
    floor = where(within[0] & within[1] & within[2], SMALLEST_VOLUME, 0.0 * mu)
    volume = at_least(sums[0] * sums[1] * sums[2], floor)
    if positive:
        share = gamma / volume
        turning = (
            where(within[0], share * sums[1] * sums[2], mu),
            where(within[1], share * sums[2] * sums[0], mu),
            where(within[2], share * sums[0] * sums[1], mu),
        )
    else:
        turning = (gamma / sums[0], gamma / sums[1], gamma / sums[2])
    twist = (double - 2.0 * turning[0], double - 2.0 * turning[1], double - 2.0 * turning[2])
    psi = (double * (s[0] - 1.0) + now, double * (s[1] - 1.0) + now, double * (s[2] - 1.0) + now)
    own = at_point + double
    h = ((own, at_point, at_point), (at_point, own, at_point), (at_point, at_point, own))
    put_principal(points, point, psi, h, (double, double, double), twist)


@kernel
def corotational_cells(
    inputs: CellInputs, cells: PointCells, into: CellOutputs | None, memory: Memory | None
) -> None:
    """Compute stress and tangent of corotational cells at all points, and finish them."""
    points, steps, weights, moduli = cells.buffers.points, cells.buffers.steps, cells.weights, cells.moduli
    batches = len(cells.cells.nodes)
    count, size = len(weights) // batches, len(moduli) // batches
    for batch in range(batches):
        place = size * batch
        deform(batch, inputs, cells)
        for q in range(count):
            put_stretches(points, POINT_ROWS * q)
            put_rotation(points, POINT_ROWS * q)
            if len(inputs.moved):
                put_found(points, POINT_ROWS * q, steps, 9 * q)
        press(batch, cells)
        for q in range(count):
            point, w = POINT_ROWS * q, row(weights, count * batch + q)
            put_corotational(points, point, moduli, place, inputs.positive)
            put_modes(points, point, w, cells.buffers.modes)
        finish_batch(batch, inputs, cells, into, memory)


class CompiledLaw(NamedTuple):
    """Kernel of a law.

    Attributes:
        moduli: Returns the moduli of the kernel for the law and values p (m, k), see PointCells, shape (m,
            n). All are proportional to the shear response but those in `fixed`.
        size: n.
        run: Adds forces and stiffness of cells to its CellOutputs, or advances its Memory after a step; see
            points.finish_batch.
        fixed: Columns of the moduli that have another unit.
    """

    moduli: Callable[[Any, Array], Array]
    size: int
    run: Callable[[CellInputs, PointCells, CellOutputs | None, Memory | None], None]
    fixed: tuple[int, ...] = ()


COMPILED_LAWS: dict[Any, CompiledLaw] = {  # by class
    SeriesRubber: CompiledLaw(rubber_moduli, 5, rubber_cells),
    Corotational: CompiledLaw(corotational_moduli, 1, corotational_cells),
    Ogden: CompiledLaw(ogden_moduli, 5, power_cells, (2, 4)),
    MooneyRivlin: CompiledLaw(mooney_rivlin_moduli, 5, power_cells, (2, 4)),
}


def compiled_law(law: Material) -> CompiledLaw | None:
    """Return the kernel of a law, with or without Prony terms; None: it has none.

    Raises:
        SceneError: Numba does not compile the function `stress_and_tangent`.
    """
    within = law_within(law)
    if within.stress_and_tangent is not None and within.has_potential:
        return None if isinstance(within, VolumetricMaterial) else _own_law(within)
    return next((each for kind, each in COMPILED_LAWS.items() if isinstance(within, kind)), None)


def _own_values(law: Material, p: Array) -> Array:
    """Return the values (m, k) of a law's parameters, its moduli."""
    return p


@cache
def _own_law(law: Material) -> CompiledLaw:
    """Return a function in place of the kernel of a law with `stress_and_tangent`; it has no memory."""
    size, at_points = len(law.parameters), compile_points(law)
    gradients_of, assemble = OneSignature(deformation_gradients), OneSignature(fill_given)

    def run(inputs: CellInputs, cells: PointCells, into: CellOutputs | None, memory: Memory | None) -> None:
        batches, m = len(cells.cells.nodes), int(cells.cells.size[0])
        q = len(cells.weights) // batches
        f, stress, tangent = np.empty((m, q, 3, 3)), np.zeros((m, q, 3, 3)), np.zeros((m, q, 3, 3, 3, 3))
        gradients_of(inputs, cells, f)
        values = cells.moduli.reshape(batches, size + 2, LANES)[:, 2:].swapaxes(1, 2).reshape(-1, size)[:m]
        at_points(
            f.reshape(-1, 3, 3), np.repeat(values, q, axis=0), stress.reshape(-1, 3, 3),
            tangent.reshape(-1, 3, 3, 3, 3),
        )  # fmt: skip
        if inputs.positive:
            tangent = clamp_tangent(tangent)
        assemble(inputs, cells, stress, tangent.reshape(m, q, 9, 9), into)

    return CompiledLaw(_own_values, size, run, tuple(range(size)))


def point_cells(group: ElementGroup, cells: CellBatches, memory: IndexArray) -> PointCells:
    """Return the cells of a group with a compiled law, see PointCells.

    `tune` sets the values of their law.
    """
    compiled = compiled_law(group.material)
    assert compiled is not None
    weights = in_lanes(group.weights)
    batches, count, _ = weights.shape
    moduli = allocate_aligned((batches * (2 + compiled.size), LANES))
    buffers = allocate_buffers(group.cells.shape[1], count)
    return PointCells(cells, weights.reshape(-1, LANES), moduli, memory, buffers)


def own_values(cells: PointCells) -> PointCells:
    """Return the same cells with moduli of their own, still zero."""
    return cells._replace(moduli=allocate_aligned(cells.moduli.shape))


def tune(cells: PointCells, group: ElementGroup, p: Array, shear_alone: bool = False) -> None:
    """Set the moduli for values p (m, k) of the law; `shear_alone`: without bulk and without relaxation."""
    compiled, law = compiled_law(group.material), law_within(group.material)
    assert compiled is not None
    left = np.ones(len(p))
    if isinstance(group.material, Relaxing):
        left = left if shear_alone else group.material.compute_equilibrium_fraction(p)
        p = group.material.own(p)
    bulk = (np.zeros(len(p)), np.zeros(len(p)))
    if isinstance(law, VolumetricMaterial):
        bulk = (law.bulk(p), bulk[1]) if mean_volume_law(group) is None else split_bulk(group, law, p)
    moduli = compiled.moduli(law, p)
    scaled = np.setdiff1d(np.arange(moduli.shape[1]), compiled.fixed)
    moduli[:, scaled] *= left[:, None]
    bulk_of_both = np.zeros((len(p), 2)) if shear_alone else np.column_stack(bulk)
    cells.moduli[:] = in_lanes(np.concatenate([bulk_of_both, moduli], axis=1)).reshape(-1, LANES)
