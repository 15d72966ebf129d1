"""Compiled assembly: forces of the elements, and their stiffness straight into the factor's panels.

The loops over elements work on the arrays themselves, taken out of their groups before: of a group that is
handed to a part of a loop every array is counted as a reference in every turn, which takes as long as the
work.
"""

from __future__ import annotations

from math import sqrt
from typing import cast

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.dynamics.numba_backend.compile import kernel
from softsim_core.dynamics.numba_backend.layout import Elements, Nodes, Work
from softsim_core.dynamics.numba_backend.rotation import rotate_lanes
from softsim_core.dynamics.numba_backend.simd_elements import (
    add_element,
    frame_rotations,
    frozen_batch,
    polar_rotations,
    turning_batch,
)
from softsim_core.fem.materials.corotational import FLAT
from softsim_core.linalg.simd import LANES, add_block

FROZEN, CLAMPED, EXACT = (cast(int, np.int64(tangent)) for tangent in range(3))
"""Stiffness of an element: of the law `qr` with its rotation frozen; of the law `polar` with negative
eigenvalues taken as zero, for a step; and its derivative as it is, for an equilibrium. Of one integer type:
for each literal, Numba would compile all kernels that take it once more."""

ROW = 4 * LANES
"""Numbers in a row of a batch's blocks, all lanes together."""


@kernel
def assemble_free(x: Array, scale: float, tangent: int, elements: Elements, work: Work) -> None:
    """Elements whose four nodes are free: forces at work.ahead, and scale times the stiffness at x."""
    corners, ids, gradients, lame = elements.corners, elements.nodes, elements.gradients, elements.lame
    starts, strides, panels = elements.starts, elements.strides, work.factor.panels
    deformation, rotations, blocks = work.deformation, work.rotations, work.blocks
    ahead, forces = work.ahead, work.forces
    for batch in range(len(ids)):
        if tangent == FROZEN:
            frame_rotations(x, corners, batch, rotations)
            frozen_batch(
                ahead, False, scale, ids, gradients, lame, batch, deformation, rotations, forces, blocks
            )
        else:
            left = polar_rotations(x, ids, gradients, batch, deformation, rotations)
            if left:
                rotate_lanes(left, deformation, rotations)
            turning_batch(
                ahead, tangent == EXACT, scale, ids, gradients, lame, batch, deformation, rotations, forces,
                blocks,
            )  # fmt: skip
        first = batch * LANES
        for lane in range(min(LANES, len(starts) - first)):
            add_element(panels, starts, strides, first + lane, blocks, lane)


@kernel
def assemble_mixed(
    x: Array, scale: float, tangent: int, elements: Elements, nodes: Nodes, work: Work
) -> None:
    """Elements with nodes in rigid regions: the part of these nodes goes to the reduced coordinates."""
    corners, ids, gradients, lame = elements.corners, elements.nodes, elements.gradients, elements.lame
    starts, strides, panels, counts = elements.starts, elements.strides, work.factor.panels, elements.counts
    deformation, rotations, k = work.deformation, work.rotations, work.blocks
    ahead, forces, jacobian, schur = work.ahead, work.forces, work.jacobian, work.factor.schur
    region_number, size, reduced, column = (
        nodes.region_number,
        nodes.size,
        nodes.reduced,
        nodes.reduced_column,
    )
    for batch in range(len(ids)):
        if tangent == FROZEN:
            frame_rotations(x, corners, batch, rotations)
            frozen_batch(ahead, False, scale, ids, gradients, lame, batch, deformation, rotations, forces, k)
        else:
            left = polar_rotations(x, ids, gradients, batch, deformation, rotations)
            if left:
                rotate_lanes(left, deformation, rotations)
            turning_batch(
                ahead, tangent == EXACT, scale, ids, gradients, lame, batch, deformation, rotations, forces, k
            )
        first = batch * LANES
        for lane in range(min(LANES, len(starts) - first)):
            e = first + lane
            free, moving = counts[e, 0], counts[e, 1]
            pair = 0
            for a in range(free):
                row = 3 * (4 * a - a * (a - 1) // 2)
                for b in range(a, free):
                    place = ROW * (row + 3 * (b - a)) + 4 * lane
                    add_block(panels, starts[e, pair], strides[e, a], k, place, ROW)
                    pair += 1
            for b in range(free, free + moving):
                z = region_number[ids[batch, b, lane]]
                for q in range(size[z]):  # K_ab J for all a, J the q-th reduced coordinate of region node b
                    unknown = reduced[z, q]
                    j0, j1, j2 = jacobian[z, q, 0], jacobian[z, q, 1], jacobian[z, q, 2]
                    for a in range(free + moving):
                        low, high = min(a, b), max(a, b)
                        row = 3 * (4 * low - low * (low - 1) // 2 + high - low)
                        if a <= b:
                            c0 = k[row, lane, 0] * j0 + k[row, lane, 1] * j1 + k[row, lane, 2] * j2
                            c1 = (
                                k[row + 1, lane, 0] * j0 + k[row + 1, lane, 1] * j1 + k[row + 1, lane, 2] * j2
                            )
                            c2 = (
                                k[row + 2, lane, 0] * j0 + k[row + 2, lane, 1] * j1 + k[row + 2, lane, 2] * j2
                            )
                        else:
                            c0 = k[row, lane, 0] * j0 + k[row + 1, lane, 0] * j1 + k[row + 2, lane, 0] * j2
                            c1 = k[row, lane, 1] * j0 + k[row + 1, lane, 1] * j1 + k[row + 2, lane, 1] * j2
                            c2 = k[row, lane, 2] * j0 + k[row + 1, lane, 2] * j1 + k[row + 2, lane, 2] * j2
                        if a < free:
                            stride = strides[e, a]
                            place = starts[e, 10 + a] + column[starts[e, 14 + a], unknown]
                            panels[place] += c0
                            panels[place + stride] += c1
                            panels[place + 2 * stride] += c2
                            continue
                        other = region_number[ids[batch, a, lane]]
                        for p in range(size[other]):
                            m = reduced[other, p]
                            if m <= unknown:
                                schur[m, unknown] += (
                                    jacobian[other, p, 0] * c0
                                    + jacobian[other, p, 1] * c1
                                    + jacobian[other, p, 2] * c2
                                )


@kernel
def assemble_nodes(v: Array, h: float, rayleigh_mass: float, nodes: Nodes, work: Work) -> None:
    """Masses, soft fixings, right-hand side; work.forces holds all node forces but mass damping."""
    impulse = np.empty(3)
    for f in range(len(nodes.free)):
        node, place, stride = nodes.free[f], nodes.row[f], nodes.stride[f]
        for i in range(3):
            row = place + i * stride
            work.factor.panels[row + nodes.column[f] + i] += nodes.diagonal[node]
            damping = rayleigh_mass * nodes.mass[node] * v[node, i]
            work.factor.panels[row + nodes.right[f]] = h * (work.forces[node, i] - damping)
    last = work.factor.schur.shape[1] - 1
    for z in range(len(nodes.region)):
        node = nodes.region[z]
        for i in range(3):
            impulse[i] = h * (work.forces[node, i] - rayleigh_mass * nodes.mass[node] * v[node, i])
        for q in range(nodes.size[z]):
            k = nodes.reduced[z, q]
            for i in range(3):
                jacobian = work.jacobian[z, q, i]
                work.factor.schur[k, last] += jacobian * impulse[i]
                for p in range(q + 1):
                    work.factor.schur[nodes.reduced[z, p], k] += (
                        nodes.diagonal[node] * jacobian * work.jacobian[z, p, i]
                    )


@kernel
def von_mises_stress(
    x: Array, polar: bool, elements: Elements, ids: IndexArray, moduli: Array, work: Work, result: Array
) -> None:
    """Von Mises stress in [Pa] of elements with the numbers `ids` (e,), into `result` (m,).

    `moduli` (m, 2): Lame parameters in [Pa] by element number.
    """
    w, cauchy, f = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for batch in range(len(elements.nodes)):
        if polar:
            left = polar_rotations(
                x, elements.nodes, elements.gradients, batch, work.deformation, work.rotations
            )
            if left:
                rotate_lanes(left, work.deformation, work.rotations)
        else:
            frame_rotations(x, elements.corners, batch, work.rotations)
        first = batch * LANES
        for lane in range(min(LANES, len(ids) - first)):
            for i in range(3):
                for j in range(3):
                    f[j] = 0.0
                    for a in range(4):
                        f[j] += (
                            x[elements.nodes[batch, a, lane], i] * elements.gradients[batch, 3 * a + j, lane]
                        )
                for j in range(3):
                    w[i, j] = 0.0
                    for k in range(3):
                        w[i, j] += f[k] * work.rotations[3 * j + k, lane]
            lam, mu = moduli[ids[first + lane]]
            pressed = lam * (w[0, 0] + w[1, 1] + w[2, 2] - 3.0) - 2.0 * mu
            for i in range(3):  # det F times the Cauchy stress: sigma W^T with W = F R^T
                for j in range(3):
                    cauchy[i, j] = pressed * w[j, i]
                    for k in range(3):
                        cauchy[i, j] += mu * (w[i, k] + w[k, i]) * w[j, k]
            volume = 0.0
            for i in range(3):
                j, k = (i + 1) % 3, (i + 2) % 3
                volume += w[0, i] * (w[1, j] * w[2, k] - w[1, k] * w[2, j])
            e0, e1, e2 = cauchy[0, 0], cauchy[1, 1], cauchy[2, 2]
            normal = (e0 - e1) ** 2 + (e1 - e2) ** 2 + (e2 - e0) ** 2
            shear = (cauchy[0, 1] + cauchy[1, 0]) ** 2
            shear += (cauchy[1, 2] + cauchy[2, 1]) ** 2 + (cauchy[0, 2] + cauchy[2, 0]) ** 2
            result[ids[first + lane]] = sqrt(0.5 * normal + 0.75 * shear) / max(abs(volume), FLAT)
