"""Compiled cells of layers, fibres and rods; the formulas are those of fem.materials.strain and fem.rods.

Of layers and fibres: with v_i = F e_i along the d strained axes (one of fibres, two of layers), the Green
strain is (v_i . v_j - 1_ij) / 2. With the gradients g_in of the shape functions along them, the block of
nodes m, n is

    w [g_im T_ij g_jn I + B_m^T D B_n],   B_n = (v_1 g_1n, v_2 g_2n, v_1 g_2n + v_2 g_1n)

where T is the stress that the last linear solve found, without its compressive part.

Of rods: with the vectors v_f of a point, the products have the slopes g_kf = Q_kfg v_g and B_kn = L_fn g_kf
at node n. With C and T the moduli and the resultants of the products, the block of nodes m, n is

    w [B_km C_kl B_ln + T_k L_fm Q_kfg L_gn I]

where T is the one that the last linear solve found. The law's damping adds w d B_km C_kl B_ln, independent of
T.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from softsim_core.base import Array, IndexArray
from softsim_core.physics.dynamics.numba_backend.layout import add_all_blocks, kernel
from softsim_core.physics.dynamics.numba_backend.points import CellInputs, CellOutputs
from softsim_core.physics.fem import ElementGroup
from softsim_core.physics.fem.materials import SLACK, Fibres, Membrane, Section
from softsim_core.physics.fem.rods import BENDING, SHORTEST, RodGroup, StrainPoints


class StrainCells(NamedTuple):
    """Cells of one element and one law, m of them with a nodes and q points.

    Attributes:
        nodes: Node indices, shape (m, a).
        weights: Rest volume at each point in [m^3], shape (m, q).
        gradients: Shape gradients in [1/m] along the d axes, shape (m, q, d, a).
        moduli: D11 = D22, D12 and D33 of D in [Pa], shape (m, 3).
        blocks: Buffer for the blocks of each pair of nodes, 00, 01, ... 11, ..., in [N/m], shape
            (m, a (a + 1) / 2, 3, 4); the last number of each row is unused.
    """

    nodes: IndexArray
    weights: Array
    gradients: Array
    moduli: Array
    blocks: Array

    def of_another_copy(self) -> StrainCells:
        """Return the same cells with values of their own."""
        return self._replace(moduli=self.moduli.copy())

    def tune(self, group: ElementGroup, p: Array) -> None:
        """Set the moduli for values p (m, k) of the law's parameters."""
        if isinstance(group.material, Fibres):
            self.moduli[:, 0] = 4.0 * p[:, 0]
            return
        stiff, ratio = p[:, 0] / (1.0 - p[:, 1] ** 2), p[:, 1]
        self.moduli[:] = np.stack([stiff, stiff * ratio, 0.5 * stiff * (1.0 - ratio)], axis=1)


def strain_cells(group: ElementGroup) -> StrainCells | None:
    """Return the cells of a group of layers or fibres, else None."""
    if not isinstance(group.material, Membrane | Fibres):
        return None
    axes = 1 if isinstance(group.material, Fibres) else 2
    gradients = np.ascontiguousarray(np.swapaxes(group.gradients[..., :axes], 2, 3))
    cells, a = np.ascontiguousarray(group.cells), group.cells.shape[1]
    moduli, blocks = np.zeros((len(cells), 3)), np.zeros((len(cells), a * (a + 1) // 2, 3, 4))
    return StrainCells(cells, np.ascontiguousarray(group.weights), gradients, moduli, blocks)


@kernel
def along_axes(nodal: Array, cells: StrainCells, e: int, q: int, out: Array) -> None:
    """Sum nodal values (n, 3) times their gradients over the nodes at point q of cell e, shape (d, 3)."""
    gradients, nodes = cells.gradients, cells.nodes
    for i in range(gradients.shape[2]):
        for k in range(3):
            total = 0.0
            for n in range(nodes.shape[1]):
                total += nodal[nodes[e, n], k] * gradients[e, q, i, n]
            out[i, k] = total


@kernel
def row_dot(v: Array, u: Array, i: int, j: int) -> float:
    """Return the dot product of row i of v and row j of u."""
    total: float = v[i, 0] * u[j, 0] + v[i, 1] * u[j, 1] + v[i, 2] * u[j, 2]
    return total


@kernel
def stress_of(e11: float, e22: float, e12: float, d11: float, d12: float, d33: float, out: Array) -> None:
    """Compute S11, S22, S12 of the strains."""
    out[0] = d11 * e11 + d12 * e22
    out[1] = d12 * e11 + d11 * e22
    out[2] = 2.0 * d33 * e12


@kernel
def leave_out_pressing(s: Array) -> None:
    """Set the negative principal values of S11, S22, S12 to zero."""
    middle, half = 0.5 * (s[0] + s[1]), 0.5 * (s[0] - s[1])
    radius = sqrt(half * half + s[2] * s[2])
    high, low = middle + radius, middle - radius
    if high <= 0.0:
        s[:] = 0.0
    elif low < 0.0:
        share = high / (high - low)
        s[0], s[1], s[2] = share * (s[0] - low), share * (s[1] - low), share * s[2]


@kernel
def fill_strain(inputs: CellInputs, cells: StrainCells, into: CellOutputs) -> None:
    """Add forces, and stiffness without negative parts, of all cells."""
    x, moved, velocities, lag, scale = inputs.x, inputs.moved, inputs.velocities, inputs.lag, inputs.scale
    forces = into.forces
    nodes, weights, gradients, moduli = cells.nodes, cells.weights, cells.gradients, cells.moduli
    blocks = cells.blocks
    count, a, axes = len(nodes), nodes.shape[1], gradients.shape[2]
    v, dv, old = np.zeros((2, 3)), np.zeros((2, 3)), np.zeros((2, 3))
    now, found, change, pull = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros((2, 3))
    b, db = np.zeros((a, 3, 3)), np.zeros((3, 3))
    for e in range(count):
        blocks[e] = 0.0
        for q in range(weights.shape[1]):
            w = weights[e, q]
            d11, d12, d33 = moduli[e, 0], moduli[e, 1], moduli[e, 2]
            along_axes(x, cells, e, q, v)
            e11, e22, e12 = 0.5 * (row_dot(v, v, 0, 0) - 1.0), 0.0, 0.0
            if axes == 2:
                e22, e12 = 0.5 * (row_dot(v, v, 1, 1) - 1.0), 0.5 * row_dot(v, v, 0, 1)
            active = axes == 2 or e11 > SLACK
            stress_of(e11, e22, e12, d11, d12, d33, now)
            if axes == 1 and e11 <= 0.0:
                now[:] = 0.0
            found[:] = now
            if len(moved):
                along_axes(moved, cells, e, q, dv)
                old[:] = v - dv
                o11, o22, o12 = 0.5 * (row_dot(old, old, 0, 0) - 1.0), 0.0, 0.0
                s11, s22, s12 = row_dot(old, dv, 0, 0), 0.0, 0.0
                if axes == 2:
                    o22, o12 = 0.5 * (row_dot(old, old, 1, 1) - 1.0), 0.5 * row_dot(old, old, 0, 1)
                    s22 = row_dot(old, dv, 1, 1)
                    s12 = 0.5 * (row_dot(old, dv, 0, 1) + row_dot(old, dv, 1, 0))
                if axes == 1 and o11 <= 0.0:
                    o11, s11 = 0.0, (s11 if o11 > SLACK else 0.0)
                stress_of(o11 + s11, o22 + s22, o12 + s12, d11, d12, d33, found)
            leave_out_pressing(found)
            if not active:
                d11 = 0.0
            along_axes(velocities, cells, e, q, dv)
            s11, s22, s12 = row_dot(v, dv, 0, 0), 0.0, 0.0
            if axes == 2:
                s22, s12 = (
                    row_dot(v, dv, 1, 1),
                    0.5 * (row_dot(v, dv, 0, 1) + row_dot(v, dv, 1, 0)),
                )
            stress_of(s11, s22, s12, d11, d12, d33, change)
            for k in range(3):
                pull[0, k] = v[0, k] * (now[0] + lag * change[0]) + v[1, k] * (now[2] + lag * change[2])
                pull[1, k] = v[0, k] * (now[2] + lag * change[2]) + v[1, k] * (now[1] + lag * change[1])
                pull[0, k] += lag * (dv[0, k] * found[0] + dv[1, k] * found[2])
                pull[1, k] += lag * (dv[0, k] * found[2] + dv[1, k] * found[1])
            for n in range(a):
                g0 = gradients[e, q, 0, n]
                g1 = gradients[e, q, 1, n] if axes == 2 else 0.0
                for k in range(3):
                    forces[nodes[e, n], k] -= w * (pull[0, k] * g0 + pull[1, k] * g1)
                    b[n, 0, k], b[n, 1, k] = v[0, k] * g0, v[1, k] * g1
                    b[n, 2, k] = v[0, k] * g1 + v[1, k] * g0
            w *= scale
            pair = 0
            for m in range(a):
                g0 = gradients[e, q, 0, m]
                g1 = gradients[e, q, 1, m] if axes == 2 else 0.0
                for k in range(3):
                    db[0, k] = w * (d11 * b[m, 0, k] + d12 * b[m, 1, k])
                    db[1, k] = w * (d12 * b[m, 0, k] + d11 * b[m, 1, k])
                    db[2, k] = w * d33 * b[m, 2, k]
                turn0, turn1 = w * (found[0] * g0 + found[2] * g1), w * (found[2] * g0 + found[1] * g1)
                for n in range(m, a):
                    h1 = gradients[e, q, 1, n] if axes == 2 else 0.0
                    turning = turn0 * gradients[e, q, 0, n] + turn1 * h1
                    for i in range(3):
                        for j in range(3):
                            blocks[e, pair, i, j] += (
                                db[0, i] * b[n, 0, j] + db[1, i] * b[n, 1, j] + db[2, i] * b[n, 2, j]
                            )
                        blocks[e, pair, i, i] += turning
                    pair += 1
    add_all_blocks(blocks, into.places, into.panels, into.pair_blocks)


class RodPoints(NamedTuple):
    """One of the two families of points of m cells, q points each; see fem.rods.StrainPoints.

    Attributes:
        members: Nodes of a cell that contribute, ascending, shape (m, q, b).
        maps: From these nodes to the vectors, shape (m, q, f, b).
        forms: See StrainPoints, shape (k, f, f).
        stretching: Whether a product is that of a vector with itself, shape (k,).
        natural: See StrainPoints, shape (m, q, k).
        stiffness: Stiffness times the lengths, shape (m, q, k, k).
        along: See StrainPoints.
        strains, vectors, taking_part: The numbers 0, 1, ..., k, f and b of them: loops over the length of a
            tuple are compiled for that length, which makes them twice as fast.
    """

    members: IndexArray
    maps: Array
    forms: Array
    stretching: IndexArray
    natural: Array
    stiffness: Array
    along: bool
    strains: tuple[int, ...]
    vectors: tuple[int, ...]
    taking_part: tuple[int, ...]


class RodCells(NamedTuple):
    """Cells of rods.

    Attributes:
        nodes: Node indices, shape (m, 9).
        line, sections: Points along the rod and at the sections.
        damping: Damping of the law in [s], shape (m,).
        blocks: See StrainCells.
    """

    nodes: IndexArray
    line: RodPoints
    sections: RodPoints
    damping: Array
    blocks: Array

    def of_another_copy(self) -> RodCells:
        """Return the same cells with values of their own."""
        line, sections = (
            each._replace(stiffness=each.stiffness.copy()) for each in (self.line, self.sections)
        )
        return self._replace(line=line, sections=sections, damping=self.damping.copy())

    def tune(self, group: ElementGroup, p: Array) -> None:
        """Set the stiffness and damping for values p (m, k) of the law's parameters."""
        assert isinstance(group, RodGroup)
        assert isinstance(group.material, Section)
        self.damping[:] = group.material.damping(p)
        for points, (family, stiffness) in zip((self.line, self.sections), group.families(p), strict=True):
            points.stiffness[:] = family.lengths[..., None, None] * stiffness


def rod_cells(group: ElementGroup) -> RodCells | None:
    """Return the cells of a group of rods, else None."""
    if not isinstance(group, RodGroup):
        return None
    cells, a = np.ascontiguousarray(group.cells), group.cells.shape[1]
    blocks = np.zeros((len(cells), a * (a + 1) // 2, 3, 4))
    return RodCells(cells, _points(group.line, a), _points(group.sections, 3), np.zeros(len(cells)), blocks)


def _points(points: StrainPoints, taking_part: int) -> RodPoints:
    members = np.sort(np.argsort(-np.abs(points.maps).sum(axis=2), axis=2, kind="stable")[..., :taking_part])
    maps = np.take_along_axis(points.maps, members[:, :, None, :], axis=3)
    stretching = np.diagonal(points.forms, axis1=1, axis2=2).any(axis=1).astype(np.int64)
    return RodPoints(
        members,
        maps,
        points.forms,
        stretching,
        points.natural.copy(),
        np.zeros_like(points.stiffness),
        points.along,
        *(tuple(range(size)) for size in (*points.forms.shape[:2], taking_part)),
    )


@kernel
def put_vectors(nodal: Array, nodes: IndexArray, points: RodPoints, e: int, q: int, out: Array) -> None:
    """Compute the vectors of nodal values (n, 3) at point q of cell e, shape (f, 3)."""
    maps, members = points.maps, points.members
    for f in range(len(points.vectors)):
        for i in range(3):
            total = 0.0
            for n in range(len(points.taking_part)):
                total += maps[e, q, f, n] * nodal[nodes[e, members[e, q, n]], i]
            out[f, i] = total


@kernel
def put_slopes(points: RodPoints, v: Array, out: Array) -> None:
    """Compute Q_k v of all products, shape (k, f, 3)."""
    forms = points.forms
    for k in range(len(points.strains)):
        for f in range(len(points.vectors)):
            for i in range(3):
                out[k, f, i] = 0.0
            for g in range(len(points.vectors)):
                if forms[k, f, g] != 0.0:
                    for i in range(3):
                        out[k, f, i] += forms[k, f, g] * v[g, i]


@kernel
def put_products(points: RodPoints, slopes: Array, v: Array, factor: float, out: Array) -> None:
    """Compute factor times v . Q_k v of all products, with the slopes of one of the two, shape (k,)."""
    for k in range(len(points.strains)):
        total = 0.0
        for f in range(len(points.vectors)):
            for i in range(3):
                total += slopes[k, f, i] * v[f, i]
        out[k] = factor * total


@kernel
def put_strains(
    points: RodPoints, e: int, q: int, products: Array, strains: Array, by_products: Array
) -> None:
    """Compute the strains (k,) of products (k,) at point q of cell e, and their slopes (k, k)."""
    by_products[:] = 0.0
    for k in range(len(points.strains)):
        strains[k] = products[k]
        by_products[k, k] = 1.0
    if points.along:
        by_length = 1.0 / max(np.sqrt(2.0 * products[0]), SHORTEST)
        strains[0] = 1.0 / by_length
        by_products[0, 0] = by_length
        for k in BENDING:
            strains[k] *= by_length
            by_products[k, k] = by_length
            by_products[k, 0] = -products[k] * by_length**3
    for k in range(len(points.strains)):
        strains[k] -= points.natural[e, q, k]


@kernel
def put_moduli(points: RodPoints, stiffness: Array, by_products: Array, between: Array, out: Array) -> None:
    """Compute the moduli of products (k, k) from those of strains; `between` is overwritten."""
    for k in range(len(points.strains)):
        for j in range(len(points.strains)):
            between[k, j] = stiffness[k, j] * by_products[j, j]
        if points.along:
            for j in BENDING:
                between[k, 0] += stiffness[k, j] * by_products[j, 0]
    for j in range(len(points.strains)):
        for k in range(len(points.strains)):
            out[k, j] = by_products[k, k] * between[k, j]
        if points.along:
            for k in BENDING:
                out[0, j] += by_products[k, 0] * between[k, j]


@kernel
def add_bent(products: Array, resultants: Array, out: Array) -> None:
    """Add the strains' second derivatives along a rod, times resultants (k,), to moduli (k, k)."""
    by_length = 1.0 / max(np.sqrt(2.0 * products[0]), SHORTEST)
    out[0, 0] -= resultants[0] * by_length**3
    for k in BENDING:
        out[0, 0] += 3.0 * resultants[k] * products[k] * by_length**5
        out[0, k] -= resultants[k] * by_length**3
        out[k, 0] -= resultants[k] * by_length**3


@kernel
def fill_points(inputs: CellInputs, cells: RodCells, points: RodPoints, forces: Array) -> None:
    """Add the forces of a family of points, and its blocks to those of the cells."""
    x, moved, velocities, lag, scale = inputs.x, inputs.moved, inputs.velocities, inputs.lag, inputs.scale
    nodes, damping, blocks = cells.nodes, cells.damping, cells.blocks
    maps, members, forms = points.maps, points.members, points.forms
    strains, vectors, taking_part = len(points.strains), len(points.vectors), len(points.taking_part)
    a = nodes.shape[1]
    v, dv = np.zeros((vectors, 3)), np.zeros((vectors, 3))
    slopes, turned = np.zeros((strains, vectors, 3)), np.zeros((strains, vectors, 3))
    products, second, rates = np.zeros(strains), np.zeros(strains), np.zeros(strains)
    strain, resultants, expected = np.zeros(strains), np.zeros(strains), np.zeros(strains)
    by_products, moduli = np.zeros((strains, strains)), np.zeros((strains, strains))
    earlier, by_earlier, linear = np.zeros((vectors, 3)), np.zeros((strains, strains)), np.zeros(strains)
    between, viscous = np.zeros((strains, strains)), np.zeros((strains, strains))
    found, acting, pull = np.zeros(strains), np.zeros(strains), np.zeros((vectors, 3))
    b, cb = np.zeros((strains, 3 * taking_part)), np.zeros((strains, 3 * taking_part))
    turning, turned_maps = np.zeros((vectors, vectors)), np.zeros((vectors, taking_part))
    row = np.zeros((3, 3 * taking_part))
    step = scale / lag if lag > 0.0 else 0.0
    for e in range(len(nodes)):
        for q in range(maps.shape[1]):
            put_vectors(x, nodes, points, e, q, v)
            put_slopes(points, v, slopes)
            put_products(points, slopes, v, 0.5, products)
            put_strains(points, e, q, products, strain, by_products)
            linear[:] = strain
            if len(moved):
                put_vectors(moved, nodes, points, e, q, dv)
                earlier[:] = v - dv
                put_slopes(points, earlier, turned)
                put_products(points, turned, earlier, 0.5, second)
                put_strains(points, e, q, second, linear, by_earlier)
                put_products(points, turned, dv, 1.0, second)
                for k in range(len(points.strains)):
                    linear[k] += by_earlier[k, k] * second[k]
                    if points.along and k in BENDING:
                        linear[k] += by_earlier[k, 0] * second[0]
            put_vectors(velocities, nodes, points, e, q, dv)
            put_slopes(points, dv, turned)
            put_products(points, slopes, dv, 1.0, rates)
            for k in range(len(points.strains)):
                resultants[k] = expected[k] = 0.0
                for j in range(len(points.strains)):
                    stiff = points.stiffness[e, q, k, j]
                    if stiff != 0.0:
                        resultants[k] += stiff * strain[j]
                        expected[k] += stiff * linear[j]
            put_moduli(points, points.stiffness[e, q], by_products, between, moduli)
            viscous[:] = damping[e] * moduli
            if points.along and len(moved):
                add_bent(products, expected, moduli)
            for k in range(len(points.strains)):
                acting[k] = by_products[k, k] * resultants[k]
                found[k] = by_products[k, k] * expected[k]
            if points.along:
                for k in BENDING:
                    acting[0] += by_products[k, 0] * resultants[k]
                    found[0] += by_products[k, 0] * expected[k]
            for k in range(len(points.strains)):
                if not len(moved):
                    found[k] = max(found[k], 0.0) if points.stretching[k] else 0.0
                for j in range(len(points.strains)):
                    acting[k] += (lag * moduli[k, j] + viscous[k, j]) * rates[j]
            pull[:] = 0.0
            turning[:] = 0.0
            for k in range(len(points.strains)):
                for f in range(len(points.vectors)):
                    for i in range(3):
                        pull[f, i] += acting[k] * slopes[k, f, i] + lag * found[k] * turned[k, f, i]
                    for g in range(len(points.vectors)):
                        turning[f, g] += scale * found[k] * forms[k, f, g]
            for n in range(len(points.taking_part)):
                node = nodes[e, members[e, q, n]]
                for f in range(len(points.vectors)):
                    for i in range(3):
                        forces[node, i] -= maps[e, q, f, n] * pull[f, i]
            b[:] = 0.0
            for k in range(len(points.strains)):
                for f in range(len(points.vectors)):
                    s0, s1, s2 = slopes[k, f, 0], slopes[k, f, 1], slopes[k, f, 2]
                    if s0 != 0.0 or s1 != 0.0 or s2 != 0.0:
                        for n in range(len(points.taking_part)):
                            b[k, 3 * n] += maps[e, q, f, n] * s0
                            b[k, 3 * n + 1] += maps[e, q, f, n] * s1
                            b[k, 3 * n + 2] += maps[e, q, f, n] * s2
            cb[:] = 0.0
            for k in range(len(points.strains)):
                for j in range(len(points.strains)):
                    stiff = scale * moduli[k, j] + step * viscous[k, j]
                    if stiff != 0.0:
                        for c in range(3 * len(points.taking_part)):
                            cb[k, c] += stiff * b[j, c]
            for f in range(len(points.vectors)):
                for n in range(len(points.taking_part)):
                    turned_maps[f, n] = 0.0
                    for g in range(len(points.vectors)):
                        turned_maps[f, n] += turning[f, g] * maps[e, q, g, n]
            for m in range(len(points.taking_part)):
                row[:] = 0.0
                for k in range(len(points.strains)):
                    c0, c1, c2 = cb[k, 3 * m], cb[k, 3 * m + 1], cb[k, 3 * m + 2]
                    for c in range(3 * m, 3 * len(points.taking_part)):
                        row[0, c] += c0 * b[k, c]
                        row[1, c] += c1 * b[k, c]
                        row[2, c] += c2 * b[k, c]
                first = members[e, q, m]
                start = first * a - first * (first - 1) // 2 - first
                for n in range(m, len(points.taking_part)):
                    pair = start + members[e, q, n]
                    along = 0.0
                    for f in range(len(points.vectors)):
                        along += maps[e, q, f, m] * turned_maps[f, n]
                    for i in range(3):
                        for j in range(3):
                            blocks[e, pair, i, j] += row[i, 3 * n + j]
                        blocks[e, pair, i, i] += along


@kernel
def fill_rods(inputs: CellInputs, cells: RodCells, into: CellOutputs) -> None:
    """Add forces and stiffness of all cells.

    Without CellInputs.moved, the stiffness has no negative parts. With a lag, the law's damping is added to
    both; the scale is then dt times the lag.
    """
    cells.blocks[:] = 0.0
    fill_points(inputs, cells, cells.line, into.forces)
    fill_points(inputs, cells, cells.sections, into.forces)
    add_all_blocks(cells.blocks, into.places, into.panels, into.pair_blocks)
