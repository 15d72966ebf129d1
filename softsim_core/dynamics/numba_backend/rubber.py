"""Compiled cells of rubber: laws that are a function of I_C = F : F, in elements of any nodes and points.

The formulas are those of fem.assembly with fem.materials.first_invariant. With the stress
P = 2 psi' F + (p - s) cof F at a point of weight w, and g the gradients of the shape functions, the block of
nodes m and n is

    w [2 psi' (g_m . g_n) I + 4 psi'' (F g_m)(F g_n)^T + (p - s) [F (g_m x g_n)]x + a_p (C g_m)(C g_n)^T]

with C = cof F, and of cells with a mean volume (a - a_p) / V g_m' g_n'^T, g' = sum w C g.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.dynamics.numba_backend.compile import kernel
from softsim_core.fem.assembly import mean_volume_law, split_bulk
from softsim_core.fem.group import ElementGroup
from softsim_core.fem.materials.first_invariant import SeriesRubber
from softsim_core.fem.materials.relaxing import Relaxing, law_within


class RubberCells(NamedTuple):
    """Cells of one element and one law, m of them with a nodes and q points.

    Attributes:
        nodes: Node indices, shape (m, a).
        weights: Rest volume at each point in [m^3], shape (m, q).
        gradients: Shape gradients in [1/m], shape (m, q, 3, a).
        series: Coefficients of psi in [Pa], see SeriesRubber, shape (m, 4).
        slope: s, the slope of psi's part by a principal stretch at rest in [Pa], shape (m,).
        bulk: Bulk coefficients in [Pa] at the points and on the mean, shape (m, 2).
    """

    nodes: IndexArray
    weights: Array
    gradients: Array
    series: Array
    slope: Array
    bulk: Array


def rubber_cells(group: ElementGroup) -> RubberCells:
    """The cells of a group of a SeriesRubber; `tune` gives them the values of their law."""
    count = len(group.cells)
    return RubberCells(
        np.ascontiguousarray(group.cells),
        group.weights,
        np.ascontiguousarray(np.swapaxes(group.gradients, 2, 3)),
        np.zeros((count, 4)),
        np.zeros(count),
        np.zeros((count, 2)),
    )


def tune(cells: RubberCells, group: ElementGroup, p: Array) -> None:
    """Take over the values p (m, k) of the law's parameters."""
    law, left = law_within(group.material), np.ones(len(p))
    if isinstance(group.material, Relaxing):
        left, p = group.material.left(p), group.material.own(p)
    assert isinstance(law, SeriesRubber)  # see PairedCells
    cells.series[:] = left[:, None] * law.series(p)
    cells.slope[:] = left * law.rest_moduli(p).slope
    if mean_volume_law(group) is None:
        cells.bulk[:, 0], cells.bulk[:, 1] = law.bulk(p), 0.0
    else:
        cells.bulk[:, 0], cells.bulk[:, 1] = split_bulk(law, p)


@kernel
def gradient_at(nodal: Array, cells: RubberCells, e: int, q: int, out: Array) -> None:
    """Sum over the nodes of nodal values (n, 3) times their gradients at point q of cell e, (3, 3)."""
    gradients, nodes = cells.gradients, cells.nodes
    for i in range(3):
        for j in range(3):
            total = 0.0
            for n in range(nodes.shape[1]):
                total += nodal[nodes[e, n], i] * gradients[e, q, j, n]
            out[i, j] = total


@kernel
def cofactor_of(f: Array, out: Array) -> float:
    """Cofactors of a matrix (3, 3); returns its determinant."""
    for i in range(3):
        k, m = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            r, s = (j + 1) % 3, (j + 2) % 3
            out[i, j] = f[k, r] * f[m, s] - f[k, s] * f[m, r]
    volume: float = f[0, 0] * out[0, 0] + f[0, 1] * out[0, 1] + f[0, 2] * out[0, 2]
    return volume


@kernel
def fill_rubber(
    x: Array,
    moved: Array,
    velocities: Array,
    lag: float,
    mean_share: float,
    cells: RubberCells,
    forces: Array,
    blocks: Array,
) -> None:
    """Add f - lag K v of the cells to the forces (n, 3), and put their stiffness.

    Args:
        x: Positions in [m], shape (n, 3).
        moved: See fem.assembly.cell_stiffness, shape (n, 3); no rows: the pressure of K is that at x.
        velocities: In [m/s], shape (n, 3).
        mean_share: See fem.assembly.cell_stiffness.
        lag: In [s].
        cells: The cells.
        forces: In [N], shape (n, 3).
        blocks: Of all ordered pairs of nodes of each cell in [N/m], shape (m a a, 3, 3).
    """
    nodes, weights, gradients = cells.nodes, cells.weights, cells.gradients
    series, bulk = cells.series, cells.bulk
    a, points = nodes.shape[1], weights.shape[1]
    f, c, df = np.empty((points, 3, 3)), np.empty((points, 3, 3)), np.empty((3, 3))
    old, old_c = np.empty((3, 3)), np.empty((3, 3))
    dilatation, before, change = np.empty(points), np.empty(points), np.empty(points)
    fg, cg, mean = np.empty((3, a)), np.empty((3, a)), np.empty((3, a))
    k, total, across = np.empty((a, 3, 3, a)), np.empty((3, 3)), np.empty((3, 3))
    for e in range(len(nodes)):
        volume, mean_now, mean_before, straining = 0.0, 0.0, 0.0, 0.0
        for q in range(points):
            w = weights[e, q]
            volume += w
            gradient_at(x, cells, e, q, f[q])
            dilatation[q] = cofactor_of(f[q], c[q]) - 1.0
            mean_now += w * dilatation[q]
            if len(moved):
                gradient_at(moved, cells, e, q, df)
                old[:] = f[q] - df
                before[q] = cofactor_of(old, old_c) - 1.0 + (old_c * df).sum()
                mean_before += w * before[q]
            gradient_at(velocities, cells, e, q, df)
            change[q] = (c[q] * df).sum()
            straining += w * change[q]
        mean_now, mean_before, straining = mean_now / volume, mean_before / volume, straining / volume
        k[:] = 0.0
        mean[:] = 0.0
        for q in range(points):
            w, t = weights[e, q], (f[q] ** 2).sum() - 3.0
            over = 1.0 / (t + 4.0)
            c1, c2, c3, log = series[e, 0], series[e, 1], series[e, 2], series[e, 3]
            first = 2.0 * w * (c1 + t * (2.0 * c2 + 3.0 * t * c3) - log * over)
            second = 4.0 * w * (2.0 * c2 + 6.0 * t * c3 + log * over * over)
            tension = w * (bulk[e, 0] * dilatation[q] + bulk[e, 1] * mean_now - cells.slope[e])
            turning = tension
            if len(moved):
                turning = w * (bulk[e, 0] * before[q] + bulk[e, 1] * mean_before - cells.slope[e])
            at_point = w * bulk[e, 0]
            gradient_at(velocities, cells, e, q, df)
            along = (f[q] * df).sum()
            pressure = at_point * change[q] + w * mean_share * bulk[e, 1] * straining
            for i in range(3):
                r, s = (i + 1) % 3, (i + 2) % 3
                for j in range(3):
                    u, v = (j + 1) % 3, (j + 2) % 3
                    turned = f[q, r, u] * df[s, v] + df[r, u] * f[q, s, v]
                    turned -= f[q, r, v] * df[s, u] + df[r, v] * f[q, s, u]
                    answer = first * df[i, j] + second * along * f[q, i, j]
                    answer += turning * turned + pressure * c[q, i, j]
                    total[i, j] = first * f[q, i, j] + tension * c[q, i, j] + lag * answer
            for i in range(3):
                for n in range(a):
                    g0, g1, g2 = gradients[e, q, 0, n], gradients[e, q, 1, n], gradients[e, q, 2, n]
                    fg[i, n] = f[q, i, 0] * g0 + f[q, i, 1] * g1 + f[q, i, 2] * g2
                    cg[i, n] = c[q, i, 0] * g0 + c[q, i, 1] * g1 + c[q, i, 2] * g2
                    mean[i, n] += w * cg[i, n]
                    forces[nodes[e, n], i] -= total[i, 0] * g0 + total[i, 1] * g1 + total[i, 2] * g2
            for m in range(a):
                g0, g1, g2 = gradients[e, q, 0, m], gradients[e, q, 1, m], gradients[e, q, 2, m]
                for i in range(3):  # F (g_m x g_n) = across g_n
                    across[i, 0] = turning * (f[q, i, 1] * g2 - f[q, i, 2] * g1)
                    across[i, 1] = turning * (f[q, i, 2] * g0 - f[q, i, 0] * g2)
                    across[i, 2] = turning * (f[q, i, 0] * g1 - f[q, i, 1] * g0)
                for i in range(3):
                    left_f, left_c = second * fg[i, m], at_point * cg[i, m]
                    for j in range(3):
                        if i == j:
                            for n in range(a):
                                k[m, i, j, n] += (
                                    left_f * fg[j, n]
                                    + left_c * cg[j, n]
                                    + first
                                    * (
                                        g0 * gradients[e, q, 0, n]
                                        + g1 * gradients[e, q, 1, n]
                                        + g2 * gradients[e, q, 2, n]
                                    )
                                )
                        else:
                            axis = 3 - i - j
                            sign = 1.0 if (i + 1) % 3 == j else -1.0
                            h0, h1, h2 = (
                                sign * across[axis, 0],
                                sign * across[axis, 1],
                                sign * across[axis, 2],
                            )
                            for n in range(a):
                                k[m, i, j, n] += (
                                    left_f * fg[j, n]
                                    + left_c * cg[j, n]
                                    + (
                                        h0 * gradients[e, q, 0, n]
                                        + h1 * gradients[e, q, 1, n]
                                        + h2 * gradients[e, q, 2, n]
                                    )
                                )
        scale, place = mean_share * bulk[e, 1] / volume, e * a * a
        for m in range(a):
            for n in range(a):
                for i in range(3):
                    for j in range(3):
                        blocks[place + m * a + n, i, j] = k[m, i, j, n] + scale * mean[i, m] * mean[j, n]


@kernel
def count_folded(x: Array, nodes: IndexArray, gradients: Array) -> int:
    """How many cells have det F <= 0 at one of their points; arguments as in RubberCells."""
    count = 0
    for e in range(len(nodes)):
        folded = False
        for q in range(gradients.shape[1]):
            f = np.zeros((3, 3))
            for n in range(nodes.shape[1]):
                for i in range(3):
                    for j in range(3):
                        f[i, j] += x[nodes[e, n], i] * gradients[e, q, j, n]
            volume = f[0, 0] * (f[1, 1] * f[2, 2] - f[1, 2] * f[2, 1])
            volume += f[0, 1] * (f[1, 2] * f[2, 0] - f[1, 0] * f[2, 2])
            volume += f[0, 2] * (f[1, 0] * f[2, 1] - f[1, 1] * f[2, 0])
            folded = folded or volume <= 0.0
        count += 1 if folded else 0
    return count
