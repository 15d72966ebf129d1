"""Compiled assembly of linear tetrahedra: forces, and stiffness directly into the factor's panels.

Arrays of a batch are laid out lane by lane: gradients (batches, 12, LANES), nodes (batches, 4, LANES).

The element blocks of the law `corotational` are those with frozen rotation plus [h_a]x D [h_b]x, with

    D = gamma M^-1 - mu I,    M = tr(S) I - S,    gamma = 2 mu - lambda tr(S - I).

Of the Hessian dP/dF only the three rotational modes can be negative: their eigenvalues are minus twice those
of D. The step uses the negative part of D, so that every element block is positive semidefinite.

With E = S - I, rho = lambda / mu and t = gamma / mu = 2 - rho tr E, D = -mu N M^-1 with N = M - t I. In the
deviator B = tr(E) / 3 I - E this is N = q I + B and M = (q + t) I + B with q = (2/3 + rho) tr E. The negative
part of D retains the positive eigenvalues n of N, as n / (n + t). As functions of B with its three
eigenvalues, D and its negative part are quadratic polynomials in B. Their coefficients follow from the
characteristic polynomial b^3 - 3 p^2 b - det B, p^2 = B : B / 6. Its signs count the positive n; where there
are one or two of them, the root that is alone on its side of zero gives the projector. The error is tiny
relative to mu, not relative to D.

Source: Kim and Eberle 2022, Dynamic deformables (eigensystem of corotational energies); Smith 1961 (roots).

The loops over elements work on arrays that are taken out of their tuples before. If a tuple were passed
inside the loop, Numba would count references to each of its arrays in every iteration, which takes as long as
the work.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from numpy.polynomial import chebyshev

from softsim_core.base import Array, IndexArray
from softsim_core.physics.dynamics.numba_backend.batches import (
    Matrix,
    Triple,
    at_least,
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
    size,
    times,
    transposed,
    triple_at,
    unit,
)
from softsim_core.physics.dynamics.numba_backend.layout import Elements, Nodes, Work, add_blocks, kernel
from softsim_core.physics.dynamics.numba_backend.stretches import nearest_rotations
from softsim_core.physics.fem.materials import FLAT, SMALLEST_VOLUME
from softsim_core.physics.linalg import (
    LANES,
    add_block,
    bits_of,
    gather,
    part,
    put,
    put_quads,
    root,
    row,
    subtract_at,
    where,
)

HALLEY_STEPS = 3
"""Number of Halley steps to the root in the polar rotation of a batch; each triples the digits."""

LAST_STEP = 1e-6
"""A batch with a larger last step, relative to the root, is computed again from its principal stretches."""


@part
def frame_rotations(x: Array, corners: IndexArray, batch: int, rotations: Array) -> None:
    """Compute rotations (9, LANES) of a batch from the frames of three corners (law `corotational_qr`)."""
    origin = gather(x, corners, 4 * batch)
    e_x = unit(minus(gather(x, corners, 4 * batch + 1), origin))
    e_z = unit(cross(e_x, minus(gather(x, corners, 4 * batch + 2), origin)))
    put_matrix(rotations, 0, transposed((e_x, cross(e_z, e_x), e_z)))


@part
def sum_over_nodes(x: Array, nodes: IndexArray, batch: int, gradients: Array, first: int) -> Matrix:
    """Return the sum over a batch's nodes of positions times gradients, three rows each from `first` on."""
    at, g = gather(x, nodes, 4 * batch), triple_at(gradients, first)
    a, b, c = scaled(at[0], g), scaled(at[1], g), scaled(at[2], g)
    for n in range(1, 4):
        at, g = gather(x, nodes, 4 * batch + n), triple_at(gradients, first + 3 * n)
        a, b, c = plus(a, scaled(at[0], g)), plus(b, scaled(at[1], g)), plus(c, scaled(at[2], g))
    return (a, b, c)


@part
def polar_rotations(
    x: Array, nodes: IndexArray, gradients: Array, batch: int, deformation: Array, rotations: Array
) -> int:
    """Compute deformation gradients and nearest rotations of a batch, each (9, LANES) (law `corotational`).

    Return the lanes, one bit each, where the root was not found, or the rotation is nearly undefined.

    Source: Markley 1993. With the nuclear-like norm k = s1 + s2 + sign(det) s3 the largest root of
    (k^2 - |F|^2)^2 - 8 k det F - 4 |cof F|^2 = 0, found from above by Halley's method,
    R = ((a + |F|^2) F + k cof F - F F^T F) / (a k - det F), a = (k^2 - |F|^2) / 2.
    """
    f = sum_over_nodes(x, nodes, batch, gradients, 12 * batch)
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
def rotate_batch(
    x: Array, is_polar: bool, corners: IndexArray, nodes: IndexArray, gradients: Array, batch: int,
    deformation: Array, rotations: Array,
) -> None:  # fmt: skip
    """Compute rotations of a batch by polar decomposition, with deformation gradients, or by frames."""
    if not is_polar:
        frame_rotations(x, corners, batch, rotations)
    elif polar_rotations(x, nodes, gradients, batch, deformation, rotations):
        nearest_rotations(deformation, rotations)


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
def crossed_rows(m: Matrix, a: Triple) -> Matrix:
    """Return the rows of M crossed with a, M [a]x."""
    return (cross(m[0], a), cross(m[1], a), cross(m[2], a))


SMALLEST = 1e-9
"""Smallest relative gap of eigenvalues, or stretch, in a denominator."""


def _largest_root(u: Any) -> Any:
    """Return y in [1/2, 1] with 4 y^3 - 3 y = 2 s^2 - 1, s = (u + 1) / 2 in [0, 1]."""
    return np.asarray(np.cos(2.0 / 3.0 * np.arccos(np.clip(0.5 * (u + 1.0), 0.0, 1.0))))


ROOT = (*chebyshev.cheb2poly(chebyshev.chebinterpolate(_largest_root, 14)).tolist(), 0.0)
"""Sixteen coefficients of a polynomial in u that equals `_largest_root` on [-1, 1] within 5e-14."""


@part
def twist_stiffness(strain: Matrix, lam: Any, mu: Any, exact: bool) -> Matrix:
    """Return D, or its negative part.

    Args:
        strain: E, symmetric.
        lam: First Lame parameter times volume; zero in lanes without an element.
        mu: Second Lame parameter times volume.
        exact: Whether to return D itself.
    """
    rho = lam / at_least(mu, 1e-300)
    trace = strain[0][0] + strain[1][1] + strain[2][2]
    third = (1.0 / 3.0) * trace
    b = (
        (third - strain[0][0], -strain[0][1], -strain[0][2]),
        (-strain[1][0], third - strain[1][1], -strain[1][2]),
        (-strain[2][0], -strain[2][1], third - strain[2][2]),
    )
    square = (times(b, b[0]), times(b, b[1]), times(b, b[2]))
    c0, c1, c2 = _coefficients(b, square, rho, trace, exact)
    diagonal, linear, quadratic = -c0 * mu, -c1 * mu, -c2 * mu
    d0 = plus(scaled(linear, b[0]), scaled(quadratic, square[0]))
    d1 = plus(scaled(linear, b[1]), scaled(quadratic, square[1]))
    d2 = plus(scaled(linear, b[2]), scaled(quadratic, square[2]))
    return (
        (d0[0] + diagonal, d0[1], d0[2]),
        (d1[0], d1[1] + diagonal, d1[2]),
        (d2[0], d2[1], d2[2] + diagonal),
    )


@part
def _coefficients(b: Matrix, square: Matrix, rho: Any, trace: Any, exact: bool) -> Triple:
    """Return c0, c1, c2 such that -D / mu, or its positive part, is c0 I + c1 B + c2 B^2."""
    p2 = at_least((1.0 / 6.0) * (square[0][0] + square[1][1] + square[2][2]), 1e-60)
    p, p3 = root(p2), 3.0 * p2
    det = (1.0 / 3.0) * contraction(b, square)
    q, t = trace * (rho + 2.0 / 3.0), 2.0 - rho * trace
    m = q + t

    # how many eigenvalues of N = q I + B are positive, by the signs of its characteristic polynomial
    det_n = (q * q - p3) * q + det
    upper, minor = q < 0.0, q * q - p2 < 0.0  # tr N < 0, sum of minors < 0
    odd = det_n >= 0.0  # one or three
    mixed = upper | minor
    three, one = odd & ~mixed, odd & mixed
    none = ~odd & upper & ~minor

    # the root that is alone on its side of zero: the largest if one is positive, the smallest if two are
    sign = where(one, 1.0, -1.0)
    cosine = (sign * det) / (2.0 * p2 * p)
    u = 2.0 * root(at_least(0.5 * (cosine + 1.0), 0.0)) - 1.0
    single = sign * p * 2.0 * _polynomial(where(u > 1.0, 1.0, u))
    rest = single * single - p3  # product of the two other roots
    gap = at_least(3.0 * single * single - p3, SMALLEST * p3)

    # a single positive eigenvalue n = q + root: n / (n + t) times its projector
    n = q + single
    # two: n / (n + t) as a linear function on their plane, from their sum and product
    product = (q - single) * q + rest
    products = at_least((m - single) * m + rest, SMALLEST)
    denominator = where(one, gap * at_least(n + t, SMALLEST), gap * products)
    # three, or D itself whatever its signs: I - t M^-1
    volume = (m * m - p3) * m + det
    whole = three
    if exact:
        whole = three | ~three
    else:
        volume = at_least(volume, SMALLEST_VOLUME)
    scale = 1.0 / where(whole, volume, denominator)
    c2 = where(one, scale * n, -scale * (product + t * n))
    c1, c0 = c2 * single, c2 * rest
    plane = where(one, 0.0, scale * gap)
    c1, c0 = c1 + plane * t, c0 + plane * (product + t * q)
    scale = scale * t
    c2 = where(whole, -scale, c2)
    c1 = where(whole, scale * m, c1)
    c0 = where(whole, scale * (p3 - m * m) + 1.0, c0)
    none = none & ~whole
    return (where(none, 0.0, c0), where(none, 0.0, c1), where(none, 0.0, c2))


@part
def _polynomial(u: Any) -> Any:
    """Evaluate `_largest_root` at u with coefficients in pairs, which shortens the chain of dependencies."""
    u2 = u * u
    u4 = u2 * u2
    low = _four(ROOT[0], ROOT[1], ROOT[2], ROOT[3], u, u2) + u4 * _four(
        ROOT[4], ROOT[5], ROOT[6], ROOT[7], u, u2
    )
    high = _four(ROOT[8], ROOT[9], ROOT[10], ROOT[11], u, u2)
    high = high + u4 * _four(ROOT[12], ROOT[13], ROOT[14], ROOT[15], u, u2)
    return low + u4 * u4 * high


@part
def _four(c0: float, c1: float, c2: float, c3: float, u: Any, u2: Any) -> Any:
    """Return c0 + c1 u + c2 u^2 + c3 u^3."""
    return (c1 * u + c0) + (c3 * u + c2) * u2


@part
def turn_gradients(rotations: Array, gradients: Array, batch: int, turned: Array) -> None:
    """Write R g of the four nodes of a batch, three rows each."""
    r = matrix_at(rotations, 0)
    for n in range(4):
        put_triple(turned, 3 * n, times(r, triple_at(gradients, 12 * batch + 3 * n)))


@part
def put_batch(
    s: Matrix, lam: Any, mu: Any, twist: Matrix | None, nodes: IndexArray, batch: int, turned: Array,
    forces: Array, blocks: Array,
) -> None:  # fmt: skip
    """Subtract S h of each node of a batch, and put blocks K_ab, a <= b, with D = `twist` if it is not None.

    Row 3 pair + i of `blocks` has four numbers for every lane, the last one zero, shape (30, LANES, 4); pairs
    run 00, 01, ... 33.
    """
    for b in range(4):
        h = triple_at(turned, 3 * b)
        subtract_at(forces, nodes, 4 * batch + b, times(s, h))
        lam_h, mu_h = scaled(lam, h), scaled(mu, h)
        if twist is not None:
            rows = crossed_rows(twist, h)
        for a in range(b + 1):
            g = triple_at(turned, 3 * a)
            x, y, z = elastic_block(g, lam_h, mu_h)
            if twist is not None:
                extra = turned_block(g, rows)
                x, y, z = plus(x, extra[0]), plus(y, extra[1]), plus(z, extra[2])
            place = 12 * (a * (7 - a) // 2 + b)
            put_quads(blocks, place, x)
            put_quads(blocks, place + 4, y)
            put_quads(blocks, place + 8, z)


@part
def frozen_batch(
    y: Array, scale: float, nodes: IndexArray, lame: Array, batch: int, turned: Array, forces: Array,
    blocks: Array,
) -> None:  # fmt: skip
    """Subtract the elastic forces of a batch at y with frozen rotations, and put its blocks times `scale`."""
    lam, mu = row(lame, 2 * batch), row(lame, 2 * batch + 1)
    s = stress(sum_over_nodes(y, nodes, batch, turned, 0), lam, mu)
    put_batch(s, scale * lam, scale * mu, None, nodes, batch, turned, forces, blocks)


@part
def turning_batch(
    y: Array, exact: bool, scale: float, nodes: IndexArray, lame: Array, batch: int, deformation: Array,
    rotations: Array, turned: Array, forces: Array, blocks: Array,
) -> None:  # fmt: skip
    """Subtract the elastic forces f(x) - K (y - x) of a batch, and put its blocks times `scale`.

    x are the positions at which `deformation` and `rotations` were taken.

    K_ab = lam h_a h_b^T + mu h_b h_a^T + mu (h_a . h_b) I + [h_a]x D [h_b]x, D of `twist_stiffness`
    """
    r, f = matrix_at(rotations, 0), matrix_at(deformation, 0)
    lam, mu = row(lame, 2 * batch), row(lame, 2 * batch + 1)
    w = sum_over_nodes(y, nodes, batch, turned, 0)
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
    twist = (scaled(scale, twist[0]), scaled(scale, twist[1]), scaled(scale, twist[2]))
    put_batch(s, scale * lam, scale * mu, twist, nodes, batch, turned, forces, blocks)


FROZEN, CLAMPED, EXACT = (cast(int, np.int64(tangent)) for tangent in range(3))
"""Tangents of an element: of `corotational_qr` with its rotation frozen; of `corotational` with negative
eigenvalues set to zero, for a step; of `corotational` unchanged, for an equilibrium.

They have one integer type, because Numba would compile all kernels once more for each literal.
"""


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


@kernel
def assemble_tetrahedra(
    x: Array, scale: float, tangent: int, elements: Elements, pair_blocks: Array, work: Work
) -> None:
    """Add forces at work.ahead, and `scale` times the stiffness at x, to panels and Pairs.blocks."""
    corners, ids, gradients, lame = elements.corners, elements.nodes, elements.gradients, elements.lame
    places, panels, ahead, forces = elements.places, work.factor.panels, work.ahead, work.forces
    deformation, rotations, turned, blocks = work.deformation, work.rotations, work.turned, work.blocks
    count, starts, strides = len(places.pair_blocks), places.starts, places.strides
    for batch in range(len(ids)):
        rotate_batch(x, tangent != FROZEN, corners, ids, gradients, batch, deformation, rotations)
        turn_gradients(rotations, gradients, batch, turned)
        if tangent == FROZEN:
            frozen_batch(ahead, scale, ids, lame, batch, turned, forces, blocks)
        else:
            turning_batch(
                ahead, tangent == EXACT, scale, ids, lame, batch, deformation, rotations, turned, forces,
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
    x: Array, is_polar: bool, elements: Elements, lame: Array, work: Work, result: Array
) -> None:
    """Write the von Mises stress in [Pa] of all lanes into `result` (B, LANES).

    `lame` (B, 2, LANES) are the Lame parameters in [Pa].
    """
    corners, ids, gradients = elements.corners, elements.nodes, elements.gradients
    deformation, rotations, turned = work.deformation, work.rotations, work.turned
    for batch in range(len(ids)):
        rotate_batch(x, is_polar, corners, ids, gradients, batch, deformation, rotations)
        turn_gradients(rotations, gradients, batch, turned)
        w = sum_over_nodes(x, ids, batch, turned, 0)
        s = stress(w, row(lame, 2 * batch), row(lame, 2 * batch + 1))
        a, b, c = times(w, s[0]), times(w, s[1]), times(w, s[2])  # det F times the Cauchy stress: S W^T
        x0, x1, x2 = a[0] - b[1], b[1] - c[2], c[2] - a[0]
        xy, yz, zx = a[1] + b[0], b[2] + c[1], c[0] + a[2]
        squares = 0.5 * (x0 * x0 + x1 * x1 + x2 * x2) + 0.75 * (xy * xy + yz * yz + zx * zx)
        put(result, batch, root(squares) / at_least(size(dot(w[0], cross(w[1], w[2]))), FLAT))
