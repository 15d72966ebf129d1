"""What forces on constraint rows do: compiled, with the factor that the last step left in the panels.

With A = L L^T on the free nodes, Y = L^-1 H^T is one forward solve for all rows at once; supernodes that no
row touches are skipped. Y^T Y is the rows' compliance with the border held; what reaches the border comes out
beside it.
"""

from __future__ import annotations

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.dynamics.fast.compile import kernel
from softsim_core.dynamics.fast.factorisation import solve_backward, subtract_products
from softsim_core.dynamics.fast.kinematics import advance_border, jacobians, place_zones, screws
from softsim_core.dynamics.fast.layout import Border, Motion, Nodes, Tree, Work
from softsim_core.dynamics.fast.simd import (
    LANES,
    ROWS,
    add_to,
    dot_product,
    solve_rows,
    tile_one,
    tile_two,
)


@kernel
def spread_rows(
    start: IndexArray, place: IndexArray, coefficient: Array, column: IndexArray, motion: Motion,
    border: Border, nodes: Nodes, tree: Tree, work: Work, spread: Array, spans: IndexArray,
) -> None:  # fmt: skip
    """H^T into `spread` (unknowns, padded rows), row r in column[r]; spans: columns of each supernode."""
    screws(motion, border, work)
    jacobians(motion, nodes, work)
    unknown, supernode, parent = nodes.first_unknown, nodes.supernode, tree.parent
    size, count, tail = len(start) - 1, len(unknown), 3 * len(nodes.free)
    for s in range(len(spans)):
        spans[s, 0], spans[s, 1] = spread.shape[1], 0
    for r in range(size):
        low = column[r] - column[r] % LANES
        for e in range(start[r], start[r + 1]):
            n = place[e]
            if n < count and unknown[n] >= 0:
                s = supernode[n]
                spans[s, 0], spans[s, 1] = min(spans[s, 0], low), max(spans[s, 1], low + LANES)
    for s in range(len(spans)):
        low, high, p = spans[s, 0], spans[s, 1], parent[s]
        if low < high and p >= 0:
            spans[p, 0], spans[p, 1] = min(spans[p, 0], low), max(spans[p, 1], high)
        for k in range(tree.columns[s]):
            spread[tree.first_column[s] + k, low:high] = 0.0
    spread[tail:] = 0.0
    for r in range(size):
        c = column[r]
        for e in range(start[r], start[r + 1]):
            n = place[e]
            if n >= count:
                spread[tail + n - count, c] += coefficient[e, 0]
            elif unknown[n] >= 0:
                for i in range(3):
                    spread[unknown[n] + i, c] += coefficient[e, i]
            elif nodes.zone_number[n] >= 0:
                z = nodes.zone_number[n]
                for q in range(nodes.size[z]):
                    for i in range(3):
                        spread[tail + nodes.border[z, q], c] += work.jacobian[z, q, i] * coefficient[e, i]


@kernel
def subtract_tiles(
    target: Array, place: int, stride: int, source: Array, a: int, b: int, pitch: int, count: int, length: int
) -> None:
    """ROWS rows of `length` numbers: target[i, j] -= sum over `count` rows of source[a + i] source[b + j]."""
    j = 0
    while j + 2 * LANES <= length:
        tile_two(target, place + j, stride, source, a, b + j, pitch, count)
        j += 2 * LANES
    if j < length:
        tile_one(target, place + j, stride, source, a, b + j, pitch, count)


@kernel
def forward_rows(
    tree: Tree, work: Work, spans: IndexArray, spread: Array, space: Array, product: Array
) -> None:
    """Y = L^-1 H^T in place, the rows of the border H_b^T - A_bi A^-1 H^T; -Y^T Y, upper triangle.

    A supernode's panel rows and its rows of Y are put side by side in `space`, where tiles find both.
    """
    panels, rows, pitch = work.panels, spread.reshape(-1), spread.shape[1]
    goal = product.reshape(-1)
    product[:] = 0.0
    coefficients = np.zeros(ROWS * ROWS)
    for s in range(len(tree.columns)):
        low, high = spans[s, 0], spans[s, 1]
        if low >= high:
            continue
        own, later, width, begin = tree.columns[s], tree.later[s], tree.width[s], tree.panel[s]
        coupled, first, place = tree.side[s] - 1, tree.first_row[s], tree.first_column[s]
        count, length = own + (-own) % ROWS, high - low
        line = width + length
        for k in range(count):
            for i in range(width):
                space[k * line + i] = panels[begin + k * width + i]
            for i in range(length):
                space[k * line + width + i] = rows[(place + k) * pitch + low + i] if k < own else 0.0
        for i in range(0, count, ROWS):
            subtract_tiles(space, i * line + width, line, space, i, width, line, i, length)
            for a in range(ROWS):
                for b in range(a):
                    coefficients[ROWS * a + b] = space[(i + b) * line + i + a]
                coefficients[ROWS * a + a] = 1.0 / space[(i + a) * line + i + a]
            solve_rows(space, i * line + width, line, coefficients, length)
        for k in range(own):
            for i in range(length):
                rows[(place + k) * pitch + low + i] = space[k * line + width + i]
        scratch = count * line
        for j in range(0, coupled, ROWS):
            for i in range(ROWS * length):
                space[scratch + i] = 0.0
            subtract_tiles(space, scratch, length, space, later + j, width, line, count, length)
            for i in range(min(ROWS, coupled - j)):
                to = tree.row_index[first + j + i] * pitch + low
                add_to(rows, to, space, scratch + i * length, length)
        for i in range(0, length, ROWS):
            subtract_products(goal, low * pitch + low, pitch, i, space, width, line, count, length)


@kernel
def respond(
    start: IndexArray, place: IndexArray, coefficient: Array, column: IndexArray, motion: Motion,
    border: Border, nodes: Nodes, tree: Tree, work: Work, spread: Array, spans: IndexArray, space: Array,
    product: Array, result: Array,
) -> None:  # fmt: skip
    """H^T and Y of all rows, and Y^T Y in their own order into `result` (r, r); see the functions above."""
    spread_rows(start, place, coefficient, column, motion, border, nodes, tree, work, spread, spans)
    forward_rows(tree, work, spans, spread, space, product)
    for r in range(len(column)):
        for q in range(r + 1):
            value = -product[min(column[r], column[q]), max(column[r], column[q])]
            result[r, q] = value
            result[q, r] = value


@kernel
def apply_impulses(
    motion: Motion, before: Motion, impulses: Array, border_change: Array, h: float, border: Border,
    nodes: Nodes, tree: Tree, work: Work, spread: Array, spans: IndexArray,
) -> float:  # fmt: skip
    """Change velocities and positions by what impulses (padded rows) do; returns the top speed, or NaN.

    `border_change` (b + c,) holds the frames and joints, then minus the impulses of cables.
    """
    tail, size = 3 * len(nodes.free), len(motion.border_velocities)
    rows, pitch = spread.reshape(-1), spread.shape[1]
    for s in range(len(tree.columns)):
        low, high = spans[s, 0], max(spans[s, 0], spans[s, 1])
        width, right = tree.width[s], tree.later[s] + tree.side[s] - 1
        for k in range(tree.columns[s]):
            at = (tree.first_column[s] + k) * pitch + low
            total = dot_product(rows, at, impulses, low, high - low) if low < high else 0.0
            work.panels[tree.panel[s] + k * width + right] = total
    for b in range(len(border_change)):
        work.solution[tail + b] = border_change[b]
    solve_backward(tree, work)
    speed, finite = 0.0, True
    for f in range(len(nodes.free)):
        node, at = nodes.free[f], nodes.unknown[f]
        for c in range(3):
            motion.velocities[node, c] += work.solution[at + c]
            velocity = motion.velocities[node, c]
            motion.positions[node, c] = before.positions[node, c] + h * velocity
            speed, finite = max(speed, abs(velocity)), finite and velocity == velocity
    for f in range(len(motion.frame_positions)):
        for c in range(3):
            motion.frame_positions[f, c] = before.frame_positions[f, c]
            for d in range(3):
                motion.frame_rotations[f, c, d] = before.frame_rotations[f, c, d]
    for b in range(size):
        motion.border_velocities[b] += border_change[b]
        velocity = motion.border_velocities[b]
        speed, finite = max(speed, abs(velocity)), finite and velocity == velocity
    joints = len(motion.joint_positions)
    for j in range(joints):
        free = motion.joint_positions[j]
        motion.joint_positions[j] = before.joint_positions[j] if border.stiffness[j] > 0.0 else free
    turning = motion.joint_positions.copy()
    advance_border(h, motion)
    for j in range(joints):
        if border.stiffness[j] == 0.0:
            motion.joint_positions[j] = turning[j]  # where it was sent, exactly
    place_zones(motion, border, nodes, work)
    return speed if finite else np.nan
