"""Compiled cells of layers and fibres, for the step; the formulas are those of fem.materials.strain.

With v_i = F e_i along the d strained axes (one of fibres, two of layers), the Green strain is
(v_i . v_j - 1_ij) / 2. With the gradients g_in of the shape functions along them, the block of nodes m, n is

    w [g_im T_ij g_jn I + B_m^T D B_n],   B_n = (v_1 g_1n, v_2 g_2n, v_1 g_2n + v_2 g_1n)

where T is the stress that the last linear solve found, without its compressive part.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from softsim_core.base import Array, IndexArray
from softsim_core.physics.dynamics.numba_backend import kernel
from softsim_core.physics.dynamics.numba_backend.cells.batches import add_all_blocks
from softsim_core.physics.dynamics.numba_backend.cells.points import CellInputs, CellOutputs
from softsim_core.physics.fem import ElementGroup
from softsim_core.physics.fem.materials import SLACK, Fibres, Membrane


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
def product(v: Array, u: Array, i: int, j: int) -> float:
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
            e11, e22, e12 = 0.5 * (product(v, v, 0, 0) - 1.0), 0.0, 0.0
            if axes == 2:
                e22, e12 = 0.5 * (product(v, v, 1, 1) - 1.0), 0.5 * product(v, v, 0, 1)
            active = axes == 2 or e11 > SLACK
            stress_of(e11, e22, e12, d11, d12, d33, now)
            if axes == 1 and e11 <= 0.0:
                now[:] = 0.0
            found[:] = now
            if len(moved):
                along_axes(moved, cells, e, q, dv)
                old[:] = v - dv
                o11, o22, o12 = 0.5 * (product(old, old, 0, 0) - 1.0), 0.0, 0.0
                s11, s22, s12 = product(old, dv, 0, 0), 0.0, 0.0
                if axes == 2:
                    o22, o12 = 0.5 * (product(old, old, 1, 1) - 1.0), 0.5 * product(old, old, 0, 1)
                    s22 = product(old, dv, 1, 1)
                    s12 = 0.5 * (product(old, dv, 0, 1) + product(old, dv, 1, 0))
                if axes == 1 and o11 <= 0.0:
                    o11, s11 = 0.0, (s11 if o11 > SLACK else 0.0)
                stress_of(o11 + s11, o22 + s22, o12 + s12, d11, d12, d33, found)
            leave_out_pressing(found)
            if not active:
                d11 = 0.0
            along_axes(velocities, cells, e, q, dv)
            s11, s22, s12 = product(v, dv, 0, 0), 0.0, 0.0
            if axes == 2:
                s22, s12 = product(v, dv, 1, 1), 0.5 * (product(v, dv, 0, 1) + product(v, dv, 1, 0))
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
