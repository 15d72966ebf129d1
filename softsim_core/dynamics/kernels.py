"""Compiled kernels of the fast time step. Plain loops; the layout is that of symbolic.Plan.

Kernels live at module level so that Numba's cache serves every process. They release the GIL.
"""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit

from softsim_core.dynamics.simd import LANES, ROWS, add_block, add_to, solve_rows, tile_one, tile_two

F = TypeVar("F", bound=Callable[..., Any])


def kernel(function: F) -> F:
    """Compile with cache, without the GIL; sums may be re-ordered, NaN and infinity keep their meaning."""
    flags = {"contract", "reassoc", "nsz", "arcp"}
    return cast(F, njit(cache=True, nogil=True, fastmath=flags, error_model="numpy")(function))


@kernel
def frame_gradients(x, corners, gradients, e, out):  # type: ignore[no-untyped-def]
    """Rotated gradients h_a of element e by the frame of three of its corners (law `qr`)."""
    a, b, c = corners[e, 0], corners[e, 1], corners[e, 2]
    x0, x1, x2 = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
    s = 1.0 / sqrt(x0 * x0 + x1 * x1 + x2 * x2)
    x0, x1, x2 = x0 * s, x1 * s, x2 * s
    w0, w1, w2 = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
    z0, z1, z2 = x1 * w2 - x2 * w1, x2 * w0 - x0 * w2, x0 * w1 - x1 * w0
    s = 1.0 / sqrt(z0 * z0 + z1 * z1 + z2 * z2)
    z0, z1, z2 = z0 * s, z1 * s, z2 * s
    y0, y1, y2 = z1 * x2 - z2 * x1, z2 * x0 - z0 * x2, z0 * x1 - z1 * x0
    for n in range(4):
        g0, g1, g2 = gradients[e, n, 0], gradients[e, n, 1], gradients[e, n, 2]
        out[n, 0] = x0 * g0 + y0 * g1 + z0 * g2
        out[n, 1] = x1 * g0 + y1 * g1 + z1 * g2
        out[n, 2] = x2 * g0 + y2 * g1 + z2 * g2


@kernel
def polar_gradients(x, nodes, gradients, e, out):  # type: ignore[no-untyped-def]
    """Rotated gradients h_a of element e by the nearest proper rotation (law `polar`).

    The rotation comes in closed form from the largest root of a quartic (Markley's fast optimal attitude matrix); it is
    proper for inverted elements too. Where it is undefined (two vanishing stretches) the frame of F's columns serves.
    """
    f = np.zeros((3, 3))
    for n in range(4):
        node = nodes[e, n]
        for i in range(3):
            for j in range(3):
                f[i, j] += x[node, i] * gradients[e, n, j]
    r = np.empty((3, 3))
    nearest_rotation(f, r)
    for n in range(4):
        for i in range(3):
            out[n, i] = (
                r[i, 0] * gradients[e, n, 0] + r[i, 1] * gradients[e, n, 1] + r[i, 2] * gradients[e, n, 2]
            )


@kernel
def nearest_rotation(f, r):  # type: ignore[no-untyped-def]
    """Nearest proper rotation r (3, 3) to f (3, 3), in the Frobenius norm.

    Source: Markley 1993. With the nuclear-like norm k = s1 + s2 + sign(det) s3 the largest root of
    (k^2 - |f|^2)^2 - 8 k det f - 4 |adj f|^2 = 0, found by Newton from above:
    r = ((a + |f|^2) f + k adj(f)^T - f f^T f) / (a k - det f), a = (k^2 - |f|^2) / 2.
    """
    c00 = f[1, 1] * f[2, 2] - f[1, 2] * f[2, 1]
    c01 = f[1, 2] * f[2, 0] - f[1, 0] * f[2, 2]
    c02 = f[1, 0] * f[2, 1] - f[1, 1] * f[2, 0]
    c10 = f[0, 2] * f[2, 1] - f[0, 1] * f[2, 2]
    c11 = f[0, 0] * f[2, 2] - f[0, 2] * f[2, 0]
    c12 = f[0, 1] * f[2, 0] - f[0, 0] * f[2, 1]
    c20 = f[0, 1] * f[1, 2] - f[0, 2] * f[1, 1]
    c21 = f[0, 2] * f[1, 0] - f[0, 0] * f[1, 2]
    c22 = f[0, 0] * f[1, 1] - f[0, 1] * f[1, 0]
    det = f[0, 0] * c00 + f[0, 1] * c01 + f[0, 2] * c02
    cc = (
        c00 * c00
        + c01 * c01
        + c02 * c02
        + c10 * c10
        + c11 * c11
        + c12 * c12
        + c20 * c20
        + c21 * c21
        + c22 * c22
    )
    ff = 0.0
    for i in range(3):
        for j in range(3):
            ff += f[i, j] * f[i, j]
    k = sqrt(3.0 * ff)
    for _ in range(40):
        p = k * k - ff
        slope = 4.0 * k * p - 8.0 * det
        if slope <= 0.0:
            break
        step = (p * p - 8.0 * k * det - 4.0 * cc) / slope
        k -= step
        if step <= 1e-15 * k:
            break
    a = 0.5 * (k * k - ff)
    denominator = a * k - det
    if denominator <= 1e-9 * k * k * k:
        _frame_of_columns(f, r)
        return
    s = 1.0 / denominator
    for i in range(3):
        # row i of f f^T f
        d0 = f[i, 0] * f[0, 0] + f[i, 1] * f[0, 1] + f[i, 2] * f[0, 2]
        d1 = f[i, 0] * f[1, 0] + f[i, 1] * f[1, 1] + f[i, 2] * f[1, 2]
        d2 = f[i, 0] * f[2, 0] + f[i, 1] * f[2, 1] + f[i, 2] * f[2, 2]
        for j in range(3):
            r[i, j] = (a + ff) * f[i, j] - (d0 * f[0, j] + d1 * f[1, j] + d2 * f[2, j])
    r[0, 0] = s * (r[0, 0] + k * c00)
    r[0, 1] = s * (r[0, 1] + k * c01)
    r[0, 2] = s * (r[0, 2] + k * c02)
    r[1, 0] = s * (r[1, 0] + k * c10)
    r[1, 1] = s * (r[1, 1] + k * c11)
    r[1, 2] = s * (r[1, 2] + k * c12)
    r[2, 0] = s * (r[2, 0] + k * c20)
    r[2, 1] = s * (r[2, 1] + k * c21)
    r[2, 2] = s * (r[2, 2] + k * c22)


@kernel
def _frame_of_columns(f, r):  # type: ignore[no-untyped-def]
    """A proper rotation from the columns of f by Gram and Schmidt, whatever is degenerate."""
    for j in range(2):
        for i in range(3):
            r[i, j] = f[i, j]
        if j == 1:
            dot = r[0, 0] * r[0, 1] + r[1, 0] * r[1, 1] + r[2, 0] * r[2, 1]
            for i in range(3):
                r[i, 1] -= dot * r[i, 0]
        length = sqrt(r[0, j] ** 2 + r[1, j] ** 2 + r[2, j] ** 2)
        if length < 1e-12:  # any direction will do: the least aligned axis, made normal to the first column
            least = 0
            if j == 1:
                for i in range(1, 3):
                    if abs(r[i, 0]) < abs(r[least, 0]):
                        least = i
            for i in range(3):
                r[i, j] = 1.0 if i == least else 0.0
            if j == 1:
                dot = r[least, 0]
                for i in range(3):
                    r[i, 1] -= dot * r[i, 0]
            length = sqrt(r[0, j] ** 2 + r[1, j] ** 2 + r[2, j] ** 2)
        for i in range(3):
            r[i, j] /= length
    r[0, 2] = r[1, 0] * r[2, 1] - r[2, 0] * r[1, 1]
    r[1, 2] = r[2, 0] * r[0, 1] - r[0, 0] * r[2, 1]
    r[2, 2] = r[0, 0] * r[1, 1] - r[1, 0] * r[0, 1]


@kernel
def element_forces(x, v, lag, nodes, e, h, lam, mu, forces):  # type: ignore[no-untyped-def]
    """Subtract element e's elastic forces at x + lag v; lam and mu carry the volume."""
    w = np.zeros((3, 3))
    for n in range(4):
        node = nodes[e, n]
        for i in range(3):
            y = x[node, i] + lag * v[node, i]
            for j in range(3):
                w[i, j] += y * h[n, j]
    e00, e11, e22 = w[0, 0] - 1.0, w[1, 1] - 1.0, w[2, 2] - 1.0
    t = lam * (e00 + e11 + e22)
    s00, s11, s22 = t + 2.0 * mu * e00, t + 2.0 * mu * e11, t + 2.0 * mu * e22
    s01, s12, s02 = mu * (w[0, 1] + w[1, 0]), mu * (w[1, 2] + w[2, 1]), mu * (w[0, 2] + w[2, 0])
    for n in range(4):
        node = nodes[e, n]
        h0, h1, h2 = h[n, 0], h[n, 1], h[n, 2]
        forces[node, 0] -= s00 * h0 + s01 * h1 + s02 * h2
        forces[node, 1] -= s01 * h0 + s11 * h1 + s12 * h2
        forces[node, 2] -= s02 * h0 + s12 * h1 + s22 * h2


@kernel
def assemble_free(x, v, lag, scale, polar, elements, panels, forces):  # type: ignore[no-untyped-def]
    """Elements whose four nodes are free: forces, and ten blocks each straight into the panels."""
    nodes, corners, gradients, lame, starts, strides = elements
    h = np.zeros((4, 4))
    for e in range(len(nodes)):
        if polar:
            polar_gradients(x, nodes, gradients, e, h)
        else:
            frame_gradients(x, corners, gradients, e, h)
        element_forces(x, v, lag, nodes, e, h, lame[e, 0], lame[e, 1], forces)
        lam, mu = scale * lame[e, 0], scale * lame[e, 1]
        pair = 0
        for a in range(4):
            for b in range(a, 4):
                add_block(panels, starts[e, pair], strides[e, a], h, a, b, lam, mu)
                pair += 1


@kernel
def assemble_mixed(  # type: ignore[no-untyped-def]
    x,
    v,
    lag,
    scale,
    polar,
    elements,
    counts,
    zone_index,
    zone_jacobian,
    zone_border,
    zone_size,
    bpos,
    panels,
    schur,
    forces,
):
    """Elements with nodes in zones or held: free nodes first, then nodes of moving zones, then held ones."""
    nodes, corners, gradients, lame, starts, strides = elements
    h = np.zeros((4, 4))
    column = np.empty(3)
    for e in range(len(nodes)):
        if polar:
            polar_gradients(x, nodes, gradients, e, h)
        else:
            frame_gradients(x, corners, gradients, e, h)
        element_forces(x, v, lag, nodes, e, h, lame[e, 0], lame[e, 1], forces)
        lam, mu = scale * lame[e, 0], scale * lame[e, 1]
        free, moving = counts[e, 0], counts[e, 1]
        pair = 0
        for a in range(free):
            for b in range(a, free):
                add_block(panels, starts[e, pair], strides[e, a], h, a, b, lam, mu)
                pair += 1
        for b in range(free, free + moving):
            z = zone_index[nodes[e, b]]
            for q in range(zone_size[z]):
                k = zone_border[z, q]
                j0, j1, j2 = zone_jacobian[z, q, 0], zone_jacobian[z, q, 1], zone_jacobian[z, q, 2]
                hb = h[b, 0] * j0 + h[b, 1] * j1 + h[b, 2] * j2
                for a in range(free + moving):  # K_ab J = lam h_a (h_b.J) + mu h_b (h_a.J) + mu (h_a.h_b) J
                    ha = mu * (h[a, 0] * j0 + h[a, 1] * j1 + h[a, 2] * j2)
                    ab = mu * (h[a, 0] * h[b, 0] + h[a, 1] * h[b, 1] + h[a, 2] * h[b, 2])
                    column[0] = lam * hb * h[a, 0] + ha * h[b, 0] + ab * j0
                    column[1] = lam * hb * h[a, 1] + ha * h[b, 1] + ab * j1
                    column[2] = lam * hb * h[a, 2] + ha * h[b, 2] + ab * j2
                    if a < free:
                        place = starts[e, 10 + a] + bpos[starts[e, 14 + a], k]
                        for i in range(3):
                            panels[place + i * strides[e, a]] += column[i]
                    else:
                        y = zone_index[nodes[e, a]]
                        for p in range(zone_size[y]):
                            m = zone_border[y, p]
                            if m <= k:
                                for i in range(3):
                                    schur[m, k] += zone_jacobian[y, p, i] * column[i]


@kernel
def assemble_nodes(  # type: ignore[no-untyped-def]
    v,
    h,
    rayleigh_mass,
    nodal,
    free_nodes,
    row_offset,
    stride,
    position,
    right,
    zone_nodes,
    zone_jacobian,
    zone_border,
    zone_size,
    panels,
    schur,
    forces,
):
    """Masses, soft fixings and right-hand side of free nodes and of nodes in moving zones.

    `nodal` holds mass and diagonal addition of each node; `forces` holds all forces on the nodes, without mass damping.
    """
    for f in range(len(free_nodes)):
        node = free_nodes[f]
        mass, diagonal = nodal[node, 0], nodal[node, 1]
        start, step = row_offset[f], stride[f]
        for i in range(3):
            panels[start + i * step + position[f] + i] += diagonal
            panels[start + i * step + right[f]] = h * (forces[node, i] - rayleigh_mass * mass * v[node, i])
    last = schur.shape[1] - 1
    for z in range(len(zone_nodes)):
        node = zone_nodes[z]
        mass, diagonal = nodal[node, 0], nodal[node, 1]
        for q in range(zone_size[z]):
            k = zone_border[z, q]
            for i in range(3):
                jacobian = zone_jacobian[z, q, i]
                schur[k, last] += jacobian * h * (forces[node, i] - rayleigh_mass * mass * v[node, i])
                for p in range(q + 1):
                    schur[zone_border[z, p], k] += diagonal * jacobian * zone_jacobian[z, p, i]


@kernel
def subtract_products(target, place, stride, row, source, first, pitch, count, length):  # type: ignore[no-untyped-def]
    """Rows row .. row + 3 of target -= source^T source over `count` rows of source, columns from the diagonal on."""
    j = row - row % LANES
    while j + 2 * LANES <= length:
        tile_two(target, place + row * stride + j, stride, source, first + row, first + j, pitch, count)
        j += 2 * LANES
    if j < length:
        tile_one(target, place + row * stride + j, stride, source, first + row, first + j, pitch, count)


@kernel
def factor_rows(panels, begin, width, row, coefficients):  # type: ignore[no-untyped-def]
    """Factor ROWS panel rows from `row` on, already updated by the rows above them."""
    start = begin + row * width
    for i in range(ROWS):
        for j in range(i + 1):
            total = panels[start + j * width + row + i]
            for q in range(j):
                total -= coefficients[ROWS * i + q] * coefficients[ROWS * j + q]
            if i == j:
                coefficients[ROWS * i + i] = 1.0 / sqrt(total)
            else:
                coefficients[ROWS * i + j] = total * coefficients[ROWS * j + j]
    skip = row - row % LANES
    solve_rows(panels, start + skip, width, coefficients, width - skip)


@kernel
def add_update(
    stack, begin, side, pitch, runs, first, end, own, later, width, panels, panel, goal, top, goal_pitch
):  # type: ignore[no-untyped-def]
    """Add a child's update (upper triangle, `side` rows of length `pitch`) to its parent's panel and update.

    The parent has `own` columns; its later unknowns start at panel column `later`; `goal` holds its update from `top`.
    """
    for r in range(first, end):
        source, place, length = runs[r, 0], runs[r, 1], runs[r, 2]
        for i in range(length):
            row, target = source + i, place + i
            if row == side - 1:
                return  # the right-hand side has no row
            base = begin + row * pitch
            in_panel = target < own
            line = panel + target * width if in_panel else top + (target - later) * goal_pitch - later
            for q in range(r, end):
                start, where, count = runs[q, 0], runs[q, 1], runs[q, 2]
                if q == r:
                    start, where, count = row, target, length - i
                if in_panel:
                    add_to(panels, line + where, stack, base + start, count)
                else:
                    add_to(goal, line + where, stack, base + start, count)


@kernel
def factor(tree, panels, stack, schur):  # type: ignore[no-untyped-def]
    """Factor all panels and solve forward; the border's matrix and right-hand side end in `schur`."""
    size = len(tree.columns)
    coefficients = np.zeros(ROWS * ROWS)
    for s in range(size):
        own, later, width, begin = tree.columns[s], tree.later[s], tree.width[s], tree.panel[s]
        pitch, top = width - later, tree.update[s]
        side = tree.side[s]
        for i in range(pitch * (side + (-side) % ROWS)):
            stack[top + i] = 0.0
        for c in range(tree.first_child[s], tree.first_child[s + 1]):
            child = tree.children[c]
            add_update(
                stack, tree.update[child], tree.side[child], tree.width[child] - tree.later[child], tree.runs,
                tree.first_run[child], tree.first_run[child + 1], own, later, width, panels, begin, stack, top, pitch,
            )  # fmt: skip
        rows = own + (-own) % ROWS
        for i in range(own, rows):
            panels[begin + i * width + i] = 1.0
        for i in range(0, rows, ROWS):
            subtract_products(panels, begin, width, i, panels, begin, width, i, width)
            factor_rows(panels, begin, width, i, coefficients)
        for i in range(0, side - 1, ROWS):
            subtract_products(stack, top, pitch, i, panels, begin + later, width, rows, pitch)
    flat = schur.reshape(-1)
    for c in range(tree.first_child[size], tree.first_child[size + 1]):
        child = tree.children[c]
        add_update(
            stack, tree.update[child], tree.side[child], tree.width[child] - tree.later[child], tree.runs,
            tree.first_run[child], tree.first_run[child + 1], 0, 0, 0, panels, 0, flat, 0, schur.shape[1],
        )  # fmt: skip


@kernel
def solve_border(schur, known, change, matrix):  # type: ignore[no-untyped-def]
    """Border unknowns from the upper triangle of `schur` (last column: right-hand side).

    Entries of `change` (b,) with `known` true are given; the others are filled in. `matrix` (b, b) is scratch.
    """
    size = len(known)
    for i in range(size):
        if known[i]:
            continue
        right = schur[i, size]
        for j in range(size):
            if known[j]:
                right -= (schur[i, j] if i < j else schur[j, i]) * change[j]
        change[i] = right
        for j in range(i, size):
            matrix[i, j] = schur[i, j]
    for i in range(size):  # Cholesky of the unknown part, rows of the upper factor, forward on the way
        if known[i]:
            continue
        for k in range(i):
            if not known[k]:
                for j in range(i, size):
                    matrix[i, j] -= matrix[k, i] * matrix[k, j]
                change[i] -= matrix[k, i] * change[k]
        scale = 1.0 / sqrt(matrix[i, i])
        for j in range(i, size):
            matrix[i, j] *= scale
        change[i] *= scale
    for i in range(size - 1, -1, -1):
        if known[i]:
            continue
        for j in range(i + 1, size):
            if not known[j]:
                change[i] -= matrix[i, j] * change[j]
        change[i] /= matrix[i, i]


@kernel
def solve_backward(tree, panels, solution, gathered):  # type: ignore[no-untyped-def]
    """Fill `solution` of the free unknowns; its tail already holds the border's."""
    for s in range(len(tree.columns) - 1, -1, -1):
        own, later, width, begin = tree.columns[s], tree.later[s], tree.width[s], tree.panel[s]
        coupled, first = tree.side[s] - 1, tree.first_row[s]
        for j in range(coupled):
            gathered[later + j] = solution[tree.row_index[first + j]]
        for k in range(own - 1, -1, -1):
            start = begin + k * width
            total = panels[start + later + coupled]
            for j in range(k + 1, own):
                total -= panels[start + j] * gathered[j]
            for j in range(later, later + coupled):
                total -= panels[start + j] * gathered[j]
            gathered[k] = total / panels[start + k]
        for k in range(own):
            solution[tree.first_column[s] + k] = gathered[k]
