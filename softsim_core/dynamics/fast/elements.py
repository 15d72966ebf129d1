"""Compiled assembly: forces of the elements, and their stiffness straight into the factor's panels."""

from __future__ import annotations

from math import sqrt

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.dynamics.fast.compile import inlined, kernel
from softsim_core.dynamics.fast.layout import Elements, Nodes, Work
from softsim_core.dynamics.fast.rotation import nearest_rotation
from softsim_core.dynamics.fast.simd import LANES, add_block
from softsim_core.dynamics.fast.simd_elements import batch_forces, frame_rotations, polar_rotations

NEWTON_TOLERANCE = 1e-12
"""A lane whose last Newton step was larger, against the root, takes the scalar rotation."""


@inlined
def rotate_and_push(x: Array, polar: bool, elements: Elements, batch: int, work: Work) -> None:
    """Rotated gradients of a batch (work.rotated) and its forces at x + lag v (work.forces)."""
    if polar:
        polar_rotations(x, elements.nodes, elements.gradients, batch, work.deformation, work.rotations)
        for lane in range(LANES):
            if not work.rotations[9, lane] < NEWTON_TOLERANCE:
                for i in range(9):
                    work.one[i // 3, i % 3] = work.deformation[i, lane]
                nearest_rotation(work.one, work.two)
                for i in range(9):
                    work.rotations[i, lane] = work.two[i // 3, i % 3]
    else:
        frame_rotations(x, elements.corners, batch, work.rotations)
    batch_forces(
        work.ahead, elements.nodes, elements.gradients, elements.lame, batch, work.rotations, work.rotated,
        work.forces
    )  # fmt: skip


@inlined
def add_free_blocks(
    elements: Elements, e: int, lane: int, free: int, lam: float, mu: float, work: Work
) -> None:
    """Stiffness blocks of the free nodes of element e."""
    pair = 0
    for a in range(free):
        for b in range(a, free):
            start, stride = elements.starts[e, pair], elements.strides[e, a]
            add_block(work.panels, start, stride, work.rotated, 4 * lane + a, 4 * lane + b, lam, mu)
            pair += 1


@kernel
def assemble_free(x: Array, scale: float, polar: bool, elements: Elements, work: Work) -> None:
    """Elements whose four nodes are free."""
    for batch in range(len(elements.nodes)):
        rotate_and_push(x, polar, elements, batch, work)
        first = batch * LANES
        for lane in range(min(LANES, len(elements.starts) - first)):
            lam, mu = scale * elements.lame[batch, 0, lane], scale * elements.lame[batch, 1, lane]
            add_free_blocks(elements, first + lane, lane, 4, lam, mu, work)


@kernel
def assemble_mixed(x: Array, scale: float, polar: bool, elements: Elements, nodes: Nodes, work: Work) -> None:
    """Elements with nodes in zones or held: the part of zone nodes goes to the border's rows."""
    for batch in range(len(elements.nodes)):
        rotate_and_push(x, polar, elements, batch, work)
        first = batch * LANES
        for lane in range(min(LANES, len(elements.starts) - first)):
            e = first + lane
            lam, mu = scale * elements.lame[batch, 0, lane], scale * elements.lame[batch, 1, lane]
            free, moving = elements.counts[e, 0], elements.counts[e, 1]
            add_free_blocks(elements, e, lane, free, lam, mu, work)
            for b in range(free, free + moving):
                z = nodes.zone_number[elements.nodes[batch, b, lane]]
                for q in range(nodes.size[z]):
                    add_border_column(elements, batch, lane, e, b, z, q, lam, mu, nodes, work)


@inlined
def add_border_column(
    elements: Elements,
    batch: int,
    lane: int,
    e: int,
    b: int,
    z: int,
    q: int,
    lam: float,
    mu: float,
    nodes: Nodes,
    work: Work,
) -> None:
    """K_ab J for zone node b (number z) of element e, the q-th border unknown of that node and all a.

    K_ab J = lam h_a (h_b . J) + mu h_b (h_a . J) + mu (h_a . h_b) J.
    """
    h, jacobian, r = work.rotated, work.jacobian, 4 * lane
    k = nodes.border[z, q]
    free, moving = elements.counts[e, 0], elements.counts[e, 1]
    j0, j1, j2 = jacobian[z, q, 0], jacobian[z, q, 1], jacobian[z, q, 2]
    b0, b1, b2 = h[r + b, 0], h[r + b, 1], h[r + b, 2]
    along_b = lam * (b0 * j0 + b1 * j1 + b2 * j2)
    for a in range(free + moving):
        a0, a1, a2 = h[r + a, 0], h[r + a, 1], h[r + a, 2]
        along_a, both = mu * (a0 * j0 + a1 * j1 + a2 * j2), mu * (a0 * b0 + a1 * b1 + a2 * b2)
        c0 = along_b * a0 + along_a * b0 + both * j0
        c1 = along_b * a1 + along_a * b1 + both * j1
        c2 = along_b * a2 + along_a * b2 + both * j2
        if a < free:
            stride = elements.strides[e, a]
            place = elements.starts[e, 10 + a] + nodes.border_column[elements.starts[e, 14 + a], k]
            work.panels[place] += c0
            work.panels[place + stride] += c1
            work.panels[place + 2 * stride] += c2
        else:
            other = nodes.zone_number[elements.nodes[batch, a, lane]]
            for p in range(nodes.size[other]):
                m = nodes.border[other, p]
                if m <= k:
                    work.schur[m, k] += (
                        jacobian[other, p, 0] * c0 + jacobian[other, p, 1] * c1 + jacobian[other, p, 2] * c2
                    )


@kernel
def assemble_nodes(v: Array, h: float, rayleigh_mass: float, nodes: Nodes, work: Work) -> None:
    """Masses, soft fixings, right-hand side; work.forces holds all node forces but mass damping."""
    impulse = np.empty(3)
    for f in range(len(nodes.free)):
        node, place, stride = nodes.free[f], nodes.row[f], nodes.stride[f]
        for i in range(3):
            row = place + i * stride
            work.panels[row + nodes.column[f] + i] += nodes.diagonal[node]
            damping = rayleigh_mass * nodes.mass[node] * v[node, i]
            work.panels[row + nodes.right[f]] = h * (work.forces[node, i] - damping)
    last = work.schur.shape[1] - 1
    for z in range(len(nodes.zone)):
        node = nodes.zone[z]
        for i in range(3):
            impulse[i] = h * (work.forces[node, i] - rayleigh_mass * nodes.mass[node] * v[node, i])
        for q in range(nodes.size[z]):
            k = nodes.border[z, q]
            for i in range(3):
                jacobian = work.jacobian[z, q, i]
                work.schur[k, last] += jacobian * impulse[i]
                for p in range(q + 1):
                    work.schur[nodes.border[z, p], k] += (
                        nodes.diagonal[node] * jacobian * work.jacobian[z, p, i]
                    )


@kernel
def von_mises_stress(
    x: Array, polar: bool, elements: Elements, ids: IndexArray, moduli: Array, work: Work, result: Array
) -> None:
    """Von Mises stress in [Pa] of elements with the numbers `ids` (e,), into `result` (m,).

    `moduli` (m, 2): Lame parameters in [Pa] by element number. work.ahead must hold x; work.forces is spoilt.
    """
    w = np.empty((3, 3))
    for batch in range(len(elements.nodes)):
        rotate_and_push(x, polar, elements, batch, work)
        first = batch * LANES
        for lane in range(min(LANES, len(ids) - first)):
            for i in range(3):
                for j in range(3):
                    w[i, j] = 0.0
                    for a in range(4):
                        w[i, j] += x[elements.nodes[batch, a, lane], i] * work.rotated[4 * lane + a, j]
            mu = moduli[ids[first + lane], 1]
            e0, e1, e2 = w[0, 0], w[1, 1], w[2, 2]
            normal = (e0 - e1) ** 2 + (e1 - e2) ** 2 + (e2 - e0) ** 2
            shear = (w[0, 1] + w[1, 0]) ** 2 + (w[1, 2] + w[2, 1]) ** 2 + (w[0, 2] + w[2, 0]) ** 2
            result[ids[first + lane]] = 2.0 * mu * sqrt(0.5 * normal + 0.75 * shear)
