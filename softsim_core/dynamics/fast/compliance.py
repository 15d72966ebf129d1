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
from softsim_core.dynamics.fast.simd import LANES, ROWS


@kernel
def spread_rows(
    start: IndexArray, index: IndexArray, coefficient: Array, motion: Motion, border: Border, nodes: Nodes,
    place: IndexArray, supernode: IndexArray, work: Work, spread: Array, spans: IndexArray,
) -> None:  # fmt: skip
    """H^T into `spread` (unknowns, padded rows), and which columns each supernode has in `spans` (s, 2)."""
    screws(motion, border, work)
    jacobians(motion, nodes, work)
    spread[:] = 0.0
    size = len(start) - 1
    for s in range(len(spans)):
        spans[s, 0], spans[s, 1] = size, 0
    count, tail = len(place), 3 * len(nodes.free)
    for r in range(size):
        for e in range(start[r], start[r + 1]):
            n = index[e]
            if n >= count:
                spread[tail + n - count, r] += coefficient[e, 0]
            elif place[n] >= 0:
                for c in range(3):
                    spread[place[n] + c, r] += coefficient[e, c]
                s = supernode[n]
                spans[s, 0], spans[s, 1] = min(spans[s, 0], r), max(spans[s, 1], r + 1)
            elif nodes.zone_number[n] >= 0:
                z = nodes.zone_number[n]
                for q in range(nodes.size[z]):
                    for c in range(3):
                        spread[tail + nodes.border[z, q], r] += work.jacobian[z, q, c] * coefficient[e, c]


@kernel
def forward_rows(tree: Tree, work: Work, parent: IndexArray, spans: IndexArray, spread: Array) -> None:
    """Y = L^-1 H^T in place; the rows of the border become H_b^T - A_bi A^-1 H^T."""
    panels, rows, pitch = work.panels, spread.reshape(-1), spread.shape[1]
    for s in range(len(tree.columns)):
        low, high = spans[s, 0], spans[s, 1]
        if low >= high:
            continue
        low -= low % LANES
        high += -high % LANES
        spans[s, 0], spans[s, 1] = low, high
        p = parent[s]
        if p >= 0:
            spans[p, 0], spans[p, 1] = min(spans[p, 0], low), max(spans[p, 1], high)
        own, later, width, begin = tree.columns[s], tree.later[s], tree.width[s], tree.panel[s]
        coupled, first, goal = tree.side[s] - 1, tree.first_row[s], tree.first_column[s]
        for k in range(own):
            line, at = begin + k * width, (goal + k) * pitch
            scale = 1.0 / panels[line + k]
            for i in range(low, high):
                rows[at + i] *= scale
            for j in range(k + 1, own):
                factor, to = panels[line + j], (goal + j) * pitch
                for i in range(low, high):
                    rows[to + i] -= factor * rows[at + i]
        for j in range(coupled):
            to, column = tree.row_index[first + j] * pitch, begin + later + j
            k = 0
            while k + 4 <= own:
                a, at = column + k * width, (goal + k) * pitch
                u0, u1 = panels[a], panels[a + width]
                u2, u3 = panels[a + 2 * width], panels[a + 3 * width]
                for i in range(low, high):
                    rows[to + i] -= (
                        u0 * rows[at + i]
                        + u1 * rows[at + pitch + i]
                        + u2 * rows[at + 2 * pitch + i]
                        + u3 * rows[at + 3 * pitch + i]
                    )
                k += 4
            while k < own:
                factor, at = panels[column + k * width], (goal + k) * pitch
                for i in range(low, high):
                    rows[to + i] -= factor * rows[at + i]
                k += 1


@kernel
def inner_products(tree: Tree, spans: IndexArray, spread: Array, product: Array) -> None:
    """-Y^T Y, upper triangle, into `product` (padded rows, padded rows)."""
    product[:] = 0.0
    goal, rows, pitch = product.reshape(-1), spread.reshape(-1), spread.shape[1]
    for s in range(len(tree.columns)):
        low, high = spans[s, 0], spans[s, 1]
        if low < high:
            first, length = tree.first_column[s] * pitch + low, high - low
            for i in range(0, length, ROWS):
                subtract_products(
                    goal, low * pitch + low, pitch, i, rows, first, pitch, tree.columns[s], length
                )


@kernel
def respond(
    start: IndexArray, index: IndexArray, coefficient: Array, motion: Motion, border: Border, nodes: Nodes,
    place: IndexArray, supernode: IndexArray, parent: IndexArray, tree: Tree, work: Work, spread: Array,
    spans: IndexArray, product: Array,
) -> None:  # fmt: skip
    """H^T, Y and -Y^T Y of all rows; see the functions above."""
    spread_rows(start, index, coefficient, motion, border, nodes, place, supernode, work, spread, spans)
    forward_rows(tree, work, parent, spans, spread)
    inner_products(tree, spans, spread, product)


@kernel
def apply_impulses(
    motion: Motion, before: Motion, impulses: Array, border_change: Array, h: float, border: Border,
    nodes: Nodes, tree: Tree, work: Work, spread: Array,
) -> float:  # fmt: skip
    """Change velocities and positions by what impulses on the rows do; returns the largest speed, or NaN."""
    tail, size = 3 * len(nodes.free), len(border_change)
    for f in range(len(nodes.free)):
        for c in range(3):
            total, u = 0.0, nodes.unknown[f] + c
            for r in range(len(impulses)):
                total += spread[u, r] * impulses[r]
            work.panels[nodes.row[f] + c * nodes.stride[f] + nodes.right[f]] = total
    for b in range(size):
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
