"""Compiled assembly of linear tetrahedra: forces, and stiffness directly into the factor's panels.

Arrays of a batch are laid out lane by lane: gradients (batches, 12, LANES), nodes (batches, 4, LANES). The
formulas are those of fem.materials.corotational.

The loops over elements work on arrays that are taken out of their tuples before. If a tuple were passed
inside the loop, Numba would count references to each of its arrays in every iteration, which takes as long as
the work.
"""

from __future__ import annotations

from math import sqrt
from typing import Any, cast

import numpy as np

from softsim_core.base import Array, IndexArray
from softsim_core.physics.dynamics.numba_backend import Elements, Nodes, Work, kernel
from softsim_core.physics.dynamics.numba_backend.cells.algebra import (
    Matrix,
    Triple,
    cofactors,
    contraction,
    cross,
    difference,
    dot,
    matrix_at,
    minus,
    plus,
    put_matrix,
    put_triple,
    scaled,
    times,
    transposed,
    triple_at,
    unit,
)
from softsim_core.physics.dynamics.numba_backend.cells.batches import add_blocks
from softsim_core.physics.dynamics.numba_backend.cells.corotational import rotate_lanes, twist_stiffness
from softsim_core.physics.fem.materials import FLAT
from softsim_core.physics.linalg import (
    LANES,
    add_block,
    bits_of,
    gather,
    part,
    put_quads,
    root,
    row,
    subtract_at,
)

HALLEY_STEPS = 3
"""Number of Halley steps to the root in the polar rotation of a batch; each triples the digits."""

LAST_STEP = 1e-6
"""A lane with a larger last step, relative to the root, is recomputed by the scalar kernel."""


PAIR = tuple(cast(int, np.int64(pair)) for pair in range(10))
"""Numbers of the pairs of nodes 00, 01, ... 33; their type is no literal, see FROZEN."""


@part
def frame_rotations(x: Array, corners: IndexArray, batch: int, rotations: Array) -> None:
    """Compute rotations (9, LANES) of a batch from the frames of three corners (law `corotational_qr`)."""
    origin = gather(x, corners, 4 * batch)
    e_x = unit(minus(gather(x, corners, 4 * batch + 1), origin))
    e_z = unit(cross(e_x, minus(gather(x, corners, 4 * batch + 2), origin)))
    put_matrix(rotations, 0, transposed((e_x, cross(e_z, e_x), e_z)))


@part
def sum_over_nodes(
    x: Array, nodes: IndexArray, batch: int, h0: Triple, h1: Triple, h2: Triple, h3: Triple
) -> Matrix:
    """Return the sum over a batch's nodes of positions times gradients h."""
    a, b = gather(x, nodes, 4 * batch), gather(x, nodes, 4 * batch + 1)
    c, d = gather(x, nodes, 4 * batch + 2), gather(x, nodes, 4 * batch + 3)
    return (
        four_scaled(a[0], h0, b[0], h1, c[0], h2, d[0], h3),
        four_scaled(a[1], h0, b[1], h1, c[1], h2, d[1], h3),
        four_scaled(a[2], h0, b[2], h1, c[2], h2, d[2], h3),
    )


@part
def four_scaled(a: Any, h0: Triple, b: Any, h1: Triple, c: Any, h2: Triple, d: Any, h3: Triple) -> Triple:
    """Return a h0 + b h1 + c h2 + d h3."""
    return plus(plus(plus(scaled(a, h0), scaled(b, h1)), scaled(c, h2)), scaled(d, h3))


@part
def polar_rotations(
    x: Array, nodes: IndexArray, gradients: Array, batch: int, deformation: Array, rotations: Array
) -> int:
    """Compute deformation gradients and nearest rotations of a batch, each (9, LANES) (law `corotational`).

    Return the lanes, one bit each, that are left to the scalar kernel: the root was not found, or the
    rotation is nearly undefined. Source: Markley 1993, see corotational.nearest_rotation; here by Halley's
    method.
    """
    g = 12 * batch
    h0, h1 = triple_at(gradients, g), triple_at(gradients, g + 3)
    h2, h3 = triple_at(gradients, g + 6), triple_at(gradients, g + 9)
    f = sum_over_nodes(x, nodes, batch, h0, h1, h2, h3)
    cofactor = cofactors(f)
    det, cc, ff = dot(f[0], cofactor[0]), contraction(cofactor, cofactor), contraction(f, f)
    k = root(3.0 * ff)
    step, eight, four = k, 8.0 * det, 4.0 * cc
    for _ in range(HALLEY_STEPS):
        p = k * k - ff
        value, slope = p * p - (k * eight + four), 4.0 * k * p - eight
        bend = 2.0 * p + 4.0 * k * k  # half the second derivative
        step = (value * slope) / (slope * slope - value * bend)
        k = k - step
    a = 0.5 * (k * k - ff)
    denominator = a * k - det
    share, scale = a + ff, 1.0 / denominator
    columns = transposed(f)
    square = (times(f, f[0]), times(f, f[1]), times(f, f[2]))
    put_triple(rotations, 0, scaled(scale, rotation_row(share, f[0], k, cofactor[0], square[0], columns)))
    put_triple(rotations, 3, scaled(scale, rotation_row(share, f[1], k, cofactor[1], square[1], columns)))
    put_triple(rotations, 6, scaled(scale, rotation_row(share, f[2], k, cofactor[2], square[2], columns)))
    put_matrix(deformation, 0, f)
    is_weak = ~(denominator >= 1e-3 * k * k * k)
    is_late = ~(LAST_STEP * k >= root(step * step))
    left: int = bits_of(is_weak | is_late)
    return left


@part
def rotation_row(share: Any, f: Triple, k: Any, cofactor: Triple, square: Triple, columns: Matrix) -> Triple:
    """Return a row of (a + |F|^2) F + k cof F - F F^T F; `square` is the row of F F^T."""
    return minus(plus(scaled(share, f), scaled(k, cofactor)), times(columns, square))


@part
def strain(w: Matrix) -> Matrix:
    """Return sym(W) - I."""
    xy, yz, zx = 0.5 * (w[0][1] + w[1][0]), 0.5 * (w[1][2] + w[2][1]), 0.5 * (w[2][0] + w[0][2])
    return ((w[0][0] - 1.0, xy, zx), (xy, w[1][1] - 1.0, yz), (zx, yz, w[2][2] - 1.0))


@part
def stress(w: Matrix, lam: Any, mu: Any) -> Matrix:
    """Return lam tr(E) I + 2 mu E with E = sym(W) - I."""
    x, y, z = w[0][0] - 1.0, w[1][1] - 1.0, w[2][2] - 1.0
    pressure, double = lam * (x + y + z), 2.0 * mu
    xy, yz, zx = mu * (w[0][1] + w[1][0]), mu * (w[1][2] + w[2][1]), mu * (w[2][0] + w[0][2])
    return (
        (pressure + double * x, xy, zx),
        (xy, pressure + double * y, yz),
        (zx, yz, pressure + double * z),
    )


@part
def elastic_block(a: Triple, lam_b: Triple, mu_b: Triple) -> Matrix:
    """Return lam a b^T + mu b a^T + mu (a . b) I for the gradients a and b of two nodes."""
    both = dot(a, mu_b)
    first = plus(scaled(a[0], lam_b), scaled(mu_b[0], a))
    second = plus(scaled(a[1], lam_b), scaled(mu_b[1], a))
    third = plus(scaled(a[2], lam_b), scaled(mu_b[2], a))
    return (
        (first[0] + both, first[1], first[2]),
        (second[0], second[1] + both, second[2]),
        (third[0], third[1], third[2] + both),
    )


@part
def turned_block(a: Triple, turned: Matrix) -> Matrix:
    """Return [a]x D [b]x from the rows of D [b]x."""
    return (
        minus(scaled(a[1], turned[2]), scaled(a[2], turned[1])),
        minus(scaled(a[2], turned[0]), scaled(a[0], turned[2])),
        minus(scaled(a[0], turned[1]), scaled(a[1], turned[0])),
    )


@part
def put_block(blocks: Array, pair: int, block: Matrix) -> None:
    """Write the block of a pair of nodes for every lane; see `frozen_batch`."""
    put_quads(blocks, 12 * pair, block[0])
    put_quads(blocks, 12 * pair + 4, block[1])
    put_quads(blocks, 12 * pair + 8, block[2])


@part
def put_turning_block(
    blocks: Array, pair: int, a: Triple, lam_b: Triple, mu_b: Triple, turned: Matrix
) -> None:
    """Write a block with the stiffness of rotation."""
    block, extra = elastic_block(a, lam_b, mu_b), turned_block(a, turned)
    put_block(blocks, pair, (plus(block[0], extra[0]), plus(block[1], extra[1]), plus(block[2], extra[2])))


@part
def turned_gradients(rotations: Array, gradients: Array, batch: int) -> tuple[Triple, Triple, Triple, Triple]:
    """Return R g of the four nodes of a batch."""
    r, g = matrix_at(rotations, 0), 12 * batch
    return (
        times(r, triple_at(gradients, g)),
        times(r, triple_at(gradients, g + 3)),
        times(r, triple_at(gradients, g + 6)),
        times(r, triple_at(gradients, g + 9)),
    )


@part
def subtract_forces(
    forces: Array, nodes: IndexArray, batch: int, s: Matrix, h0: Triple, h1: Triple, h2: Triple, h3: Triple
) -> None:
    """Subtract S h of each node."""
    subtract_at(forces, nodes, 4 * batch, times(s, h0))
    subtract_at(forces, nodes, 4 * batch + 1, times(s, h1))
    subtract_at(forces, nodes, 4 * batch + 2, times(s, h2))
    subtract_at(forces, nodes, 4 * batch + 3, times(s, h3))


@part
def frozen_batch(
    y: Array, scale: float, nodes: IndexArray, gradients: Array, lame: Array, batch: int, rotations: Array,
    forces: Array, blocks: Array,
) -> None:  # fmt: skip
    """Subtract the elastic forces of a batch at y with frozen rotations; put blocks of scale K_ab, a <= b.

    Row 3 pair + i of `blocks` has four numbers for every lane, the last one zero, shape (30, LANES, 4); pairs
    run 00, 01, ... 33.
    """
    h0, h1, h2, h3 = turned_gradients(rotations, gradients, batch)
    lam, mu = row(lame, 2 * batch), row(lame, 2 * batch + 1)
    s = stress(sum_over_nodes(y, nodes, batch, h0, h1, h2, h3), lam, mu)
    subtract_forces(forces, nodes, batch, s, h0, h1, h2, h3)
    lam, mu = scale * lam, scale * mu
    lam_h, mu_h = scaled(lam, h0), scaled(mu, h0)
    put_block(blocks, PAIR[0], elastic_block(h0, lam_h, mu_h))
    lam_h, mu_h = scaled(lam, h1), scaled(mu, h1)
    put_block(blocks, PAIR[1], elastic_block(h0, lam_h, mu_h))
    put_block(blocks, PAIR[4], elastic_block(h1, lam_h, mu_h))
    lam_h, mu_h = scaled(lam, h2), scaled(mu, h2)
    put_block(blocks, PAIR[2], elastic_block(h0, lam_h, mu_h))
    put_block(blocks, PAIR[5], elastic_block(h1, lam_h, mu_h))
    put_block(blocks, PAIR[7], elastic_block(h2, lam_h, mu_h))
    lam_h, mu_h = scaled(lam, h3), scaled(mu, h3)
    put_block(blocks, PAIR[3], elastic_block(h0, lam_h, mu_h))
    put_block(blocks, PAIR[6], elastic_block(h1, lam_h, mu_h))
    put_block(blocks, PAIR[8], elastic_block(h2, lam_h, mu_h))
    put_block(blocks, PAIR[9], elastic_block(h3, lam_h, mu_h))


@part
def turning_batch(
    y: Array, exact: bool, scale: float, nodes: IndexArray, gradients: Array, lame: Array, batch: int,
    deformation: Array, rotations: Array, forces: Array, blocks: Array,
) -> None:  # fmt: skip
    """Subtract the elastic forces f(x) - K (y - x) of a batch, and put its blocks as `frozen_batch` does.

    x are the positions at which `deformation` and `rotations` were taken.

    K_ab = lam h_a h_b^T + mu h_b h_a^T + mu (h_a . h_b) I + [h_a]x D [h_b]x, D of `twist_stiffness`
    """
    r, f = matrix_at(rotations, 0), matrix_at(deformation, 0)
    h0, h1, h2, h3 = turned_gradients(rotations, gradients, batch)
    lam, mu = row(lame, 2 * batch), row(lame, 2 * batch + 1)
    w = sum_over_nodes(y, nodes, batch, h0, h1, h2, h3)
    before = (times(r, f[0]), times(r, f[1]), times(r, f[2]))
    twist = twist_stiffness(strain(before), lam, mu, exact)
    moved = difference(w, before)
    z = times(twist, (moved[2][1] - moved[1][2], moved[0][2] - moved[2][0], moved[1][0] - moved[0][1]))
    s = stress(w, lam, mu)
    s = (
        (s[0][0], s[0][1] + z[2], s[0][2] - z[1]),
        (s[1][0] - z[2], s[1][1], s[1][2] + z[0]),
        (s[2][0] + z[1], s[2][1] - z[0], s[2][2]),
    )
    subtract_forces(forces, nodes, batch, s, h0, h1, h2, h3)
    lam, mu = scale * lam, scale * mu
    twist = (scaled(scale, twist[0]), scaled(scale, twist[1]), scaled(scale, twist[2]))
    lam_h, mu_h, turned = scaled(lam, h0), scaled(mu, h0), crossed_rows(twist, h0)
    put_turning_block(blocks, PAIR[0], h0, lam_h, mu_h, turned)
    lam_h, mu_h, turned = scaled(lam, h1), scaled(mu, h1), crossed_rows(twist, h1)
    put_turning_block(blocks, PAIR[1], h0, lam_h, mu_h, turned)
    put_turning_block(blocks, PAIR[4], h1, lam_h, mu_h, turned)
    lam_h, mu_h, turned = scaled(lam, h2), scaled(mu, h2), crossed_rows(twist, h2)
    put_turning_block(blocks, PAIR[2], h0, lam_h, mu_h, turned)
    put_turning_block(blocks, PAIR[5], h1, lam_h, mu_h, turned)
    put_turning_block(blocks, PAIR[7], h2, lam_h, mu_h, turned)
    lam_h, mu_h, turned = scaled(lam, h3), scaled(mu, h3), crossed_rows(twist, h3)
    put_turning_block(blocks, PAIR[3], h0, lam_h, mu_h, turned)
    put_turning_block(blocks, PAIR[6], h1, lam_h, mu_h, turned)
    put_turning_block(blocks, PAIR[8], h2, lam_h, mu_h, turned)
    put_turning_block(blocks, PAIR[9], h3, lam_h, mu_h, turned)


@part
def crossed_rows(m: Matrix, a: Triple) -> Matrix:
    """Return the rows of M crossed with a, M [a]x."""
    return (cross(m[0], a), cross(m[1], a), cross(m[2], a))


@part
def add_free_element(
    panels: Array, starts: IndexArray, strides: IndexArray, e: int, blocks: Array, lane: int
) -> None:
    """Add the ten blocks of element e, whose nodes are all free, to the panels, as `add_blocks` does."""
    pair, pitch = 0, 4 * LANES
    for a in range(4):
        for _ in range(a, 4):
            add_block(panels, starts[e, pair], strides[e, a], blocks, 3 * pair * pitch + 4 * lane, pitch)
            pair += 1


FROZEN, CLAMPED, EXACT = (cast(int, np.int64(tangent)) for tangent in range(3))
"""Tangents of an element: of `corotational_qr` with its rotation frozen; of `corotational` with negative
eigenvalues set to zero, for a step; of `corotational` unchanged, for an equilibrium.

They have one integer type, because Numba would compile all kernels once more for each literal.
"""


@kernel
def assemble_tetrahedra(
    x: Array, scale: float, tangent: int, elements: Elements, pair_blocks: Array, work: Work
) -> None:
    """Add forces at work.ahead, and `scale` times the stiffness at x, to panels and Pairs.blocks."""
    corners, ids, gradients, lame = elements.corners, elements.nodes, elements.gradients, elements.lame
    places, panels, ahead, forces = elements.places, work.factor.panels, work.ahead, work.forces
    deformation, rotations, blocks = work.deformation, work.rotations, work.blocks
    count, starts, strides = len(places.pair_blocks), places.starts, places.strides
    for batch in range(len(ids)):
        if tangent == FROZEN:
            frame_rotations(x, corners, batch, rotations)
            frozen_batch(ahead, scale, ids, gradients, lame, batch, rotations, forces, blocks)
        else:
            left = polar_rotations(x, ids, gradients, batch, deformation, rotations)
            if left:
                rotate_lanes(left, deformation, rotations)
            turning_batch(
                ahead, tangent == EXACT, scale, ids, gradients, lame, batch, deformation, rotations, forces,
                blocks,
            )  # fmt: skip
        first = batch * LANES
        for lane in range(min(LANES, count - first)):
            e = first + lane
            if strides[e, 3] > 0:
                add_free_element(panels, starts, strides, e, blocks, lane)
            else:
                add_blocks(blocks, 4 * lane, 4 * LANES, e, places, panels, pair_blocks)


@kernel
def assemble_nodes(v: Array, h: float, rayleigh_mass: float, nodes: Nodes, work: Work) -> None:
    """Add masses, soft fixings and right-hand side; work.forces has all node forces but mass damping."""
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
    """Write the von Mises stress in [Pa] of elements with the numbers `ids` (e,) into `result` (m,).

    `moduli` (m, 2) are the Lame parameters in [Pa] by element number.
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
