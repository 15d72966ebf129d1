"""What forces on constraint rows do: compiled, with the factor that the last step left in the panels.

With A = L L^T on the free nodes, Y = L^-1 H^T is one forward solve for all rows at once; supernodes that no
row touches are skipped. Y^T Y is the rows' compliance with frames and joints at rest; what reaches these
reduced coordinates comes out beside it.
"""

from __future__ import annotations

import numpy as np

from softsim_core.actuation.compiled.kinds import CompiledKinds
from softsim_core.arrays import Array, IndexArray
from softsim_core.dynamics.numba_backend.actuator_rows import report_impulses
from softsim_core.dynamics.numba_backend.compile import kernel
from softsim_core.dynamics.numba_backend.kinematics import (
    advance_reduced,
    jacobians,
    motion_subspace,
    place_regions,
    slides,
)
from softsim_core.dynamics.numba_backend.layout import ActuatorRows, Kinematics, Motion, Nodes, Work
from softsim_core.linalg.cholesky import forward_rows, solve_backward
from softsim_core.linalg.layout import Tree
from softsim_core.linalg.simd import LANES, dot_product


@kernel
def spread_rows(
    start: IndexArray, place: IndexArray, coefficient: Array, column: IndexArray, motion: Motion,
    kinematics: Kinematics, nodes: Nodes, tree: Tree, work: Work, spread: Array, spans: IndexArray,
) -> None:  # fmt: skip
    """H^T into `spread` (unknowns, padded rows), row r in column[r]; spans: columns of each supernode."""
    motion_subspace(motion, kinematics, work)
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
            elif nodes.region_number[n] >= 0:
                z = nodes.region_number[n]
                for q in range(nodes.size[z]):
                    for i in range(3):
                        spread[tail + nodes.reduced[z, q], c] += work.jacobian[z, q, i] * coefficient[e, i]


@kernel
def respond(
    start: IndexArray, place: IndexArray, coefficient: Array, column: IndexArray, motion: Motion,
    kinematics: Kinematics, nodes: Nodes, tree: Tree, work: Work, spread: Array, spans: IndexArray,
    space: Array, product: Array, result: Array,
) -> None:  # fmt: skip
    """H^T and Y of all rows, and Y^T Y in their own order into `result` (r, r); see the functions above."""
    spread_rows(start, place, coefficient, column, motion, kinematics, nodes, tree, work, spread, spans)
    forward_rows(tree, work.factor, spans, spread, space, product)
    for r in range(len(column)):
        for q in range(r + 1):
            value = -product[min(column[r], column[q]), max(column[r], column[q])]
            result[r, q] = value
            result[q, r] = value


@kernel
def apply_impulses(
    motion: Motion, before: Motion, impulses: Array, reduced_change: Array, h: float, kinematics: Kinematics,
    nodes: Nodes, rows: ActuatorRows, kinds: CompiledKinds, tree: Tree, work: Work, spread: Array,
    spans: IndexArray,
) -> float:  # fmt: skip
    """Change velocities and positions by what impulses (padded rows) do; returns the top speed, or NaN.

    `reduced_change` (b + c,) holds the frames and joints, then minus the impulses of actuators.
    """
    tail, size = 3 * len(nodes.free), len(motion.reduced_velocities)
    flat, pitch = spread.reshape(-1), spread.shape[1]
    for s in range(len(tree.columns)):
        low, high = spans[s, 0], max(spans[s, 0], spans[s, 1])
        width, right = tree.width[s], tree.later[s] + tree.side[s] - 1
        for k in range(tree.columns[s]):
            at = (tree.first_column[s] + k) * pitch + low
            total = dot_product(flat, at, impulses, low, high - low) if low < high else 0.0
            work.factor.panels[tree.panel[s] + k * width + right] = total
    for b in range(len(reduced_change)):
        work.factor.solution[tail + b] = reduced_change[b]
    solve_backward(tree, work.factor)
    speed, finite = 0.0, True
    for f in range(len(nodes.free)):
        node, at = nodes.free[f], nodes.unknown[f]
        for c in range(3):
            motion.velocities[node, c] += work.factor.solution[at + c]
            velocity = motion.velocities[node, c]
            motion.positions[node, c] = before.positions[node, c] + h * velocity
            speed, finite = max(speed, abs(velocity)), finite and velocity == velocity
    for f in range(len(motion.frame_positions)):
        for c in range(3):
            motion.frame_positions[f, c] = before.frame_positions[f, c]
            for d in range(3):
                motion.frame_rotations[f, c, d] = before.frame_rotations[f, c, d]
    for b in range(size):
        motion.reduced_velocities[b] += reduced_change[b]
        velocity = motion.reduced_velocities[b]
        finite = finite and velocity == velocity
        if slides(b, motion, kinematics):
            speed = max(speed, abs(velocity))
    joints = len(motion.joint_positions)
    for j in range(joints):
        free = motion.joint_positions[j]
        motion.joint_positions[j] = before.joint_positions[j] if kinematics.stiffness[j] > 0.0 else free
    turning = motion.joint_positions.copy()
    advance_reduced(h, motion)
    for j in range(joints):
        if kinematics.stiffness[j] == 0.0:
            motion.joint_positions[j] = turning[j]  # where it was sent, exactly
    place_regions(motion, kinematics, nodes, work)
    report_impulses(h, reduced_change[size:], motion, rows, kinds, work)
    return speed if finite else np.nan
