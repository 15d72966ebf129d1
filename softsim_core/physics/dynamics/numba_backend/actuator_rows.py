"""Compiled rows of actuators: their stiffness, the faces that they press on, their bounded multipliers.

A row H is stored as one more column of the reduced coordinates in the panels, so that factoring the step's
matrix also gives H A^-1 H^T; see kinematics. Values and coefficients of kinds without compiled kernels are
filled in before.
"""

from __future__ import annotations

from math import inf, nan, sqrt
from typing import NamedTuple

import numpy as np

from softsim_core.base import Array, BoolArray, IndexArray
from softsim_core.physics.actuation.compiled import CompiledKinds, fill, measure
from softsim_core.physics.dynamics.numba_backend.layout import (
    ActuatorRows,
    ActuatorStiffness,
    Motion,
    Nodes,
    Work,
    kernel,
)
from softsim_core.physics.linalg import FACES_PER_FORCE, SMALLEST_PIVOT, SOLVED, WRONG_SIDE, Tree, inline

TINY = float(np.finfo(float).tiny)


@kernel
def bounded_forces(matrix: Array, gap: Array, lower: Array, upper: Array, forces: Array) -> None:
    """Solve for the forces (c,) in [N] as linalg.bounded.solve_bounded does.

    NaN where there is no solution.
    """
    size = len(gap)
    factor, sums, active = np.empty((size, size)), np.empty(size), np.empty(size, np.bool_)
    active_sets(matrix, gap, lower, upper, forces, factor, sums, active)
    if residual_of(matrix, gap, lower, upper, forces, sums) <= SOLVED:
        return
    walk_faces(matrix, gap, lower, upper, forces, factor, sums, active)
    if not residual_of(matrix, gap, lower, upper, forces, sums) <= SOLVED:
        for c in range(size):
            forces[c] = nan


@kernel
def remainder_of(matrix: Array, gap: Array, forces: Array, c: int) -> float:
    """Return row c of gap + matrix . forces."""
    rest = gap[c]
    for d in range(len(gap)):
        rest += matrix[c, d] * forces[d]
    return float(rest)


@kernel
def sum_rows(matrix: Array, gap: Array, forces: Array, sums: Array) -> None:
    """Write the magnitude of the terms that add up in each row into `sums` (c,)."""
    size, most, reach = len(gap), 0.0, 0.0
    for c in range(size):
        most = max(most, abs(gap[c]))
        reach += sqrt(abs(matrix[c, c])) * abs(forces[c])
    for c in range(size):
        sums[c] = max(most + sqrt(abs(matrix[c, c])) * reach, TINY)


@kernel
def residual_of(matrix: Array, gap: Array, lower: Array, upper: Array, forces: Array, sums: Array) -> float:
    """Return the residual of `linalg.bounded.bounded_residual`; infinite where a force is NaN."""
    sum_rows(matrix, gap, forces, sums)
    worst = 0.0
    for c in range(len(gap)):
        if not (lower[c] <= forces[c] <= upper[c]):
            return inf
        rest = remainder_of(matrix, gap, forces, c) / sums[c]
        if not abs(rest) < inf:
            return inf
        if forces[c] > lower[c]:
            worst = max(worst, rest)
        if forces[c] < upper[c]:
            worst = max(worst, -rest)
    return worst


@kernel
def solve_active(matrix: Array, gap: Array, active: BoolArray, forces: Array, factor: Array) -> None:
    """Solve for the forces of the held rows so that gap + matrix . forces = 0 there; the others are given."""
    size = len(gap)
    for i in range(size):
        if not active[i]:
            continue
        forces[i] = -gap[i]
        for j in range(size):
            factor[i, j] = matrix[i, j]
            if not active[j]:
                forces[i] -= matrix[i, j] * forces[j]
    for i in range(size):
        if not active[i]:
            continue
        if factor[i, i] < SMALLEST_PIVOT * matrix[i, i]:
            factor[i, i] = SMALLEST_PIVOT * matrix[i, i]
        scale = 1.0 / sqrt(factor[i, i])
        forces[i] *= scale
        for j in range(i, size):
            factor[i, j] *= scale
        for k in range(i + 1, size):
            if active[k]:
                forces[k] -= factor[i, k] * forces[i]
                for j in range(k, size):
                    factor[k, j] -= factor[i, k] * factor[i, j]
    for i in range(size - 1, -1, -1):
        if active[i]:
            for j in range(i + 1, size):
                if active[j]:
                    forces[i] -= factor[i, j] * forces[j]
            forces[i] /= factor[i, i]


@kernel
def active_sets(
    matrix: Array, gap: Array, lower: Array, upper: Array, forces: Array, factor: Array, sums: Array,
    active: BoolArray,
) -> None:  # fmt: skip
    """Solve by active sets, releasing and holding rows all at once; may end without a solution."""
    size = len(gap)
    hold = np.empty(size, np.bool_)
    for c in range(size):
        active[c] = lower[c] < upper[c]
        forces[c] = 0.0 if active[c] else lower[c]
    for _ in range(2 * size + 1):
        solve_active(matrix, gap, active, forces, factor)
        sum_rows(matrix, gap, forces, sums)
        settled = True
        for c in range(size):
            if active[c]:
                hold[c] = lower[c] <= forces[c] <= upper[c]
            else:
                rest = remainder_of(matrix, gap, forces, c)
                tiny = WRONG_SIDE * sums[c]
                back = rest < -tiny if forces[c] <= lower[c] else rest > tiny
                hold[c] = back and lower[c] < upper[c]
            settled = settled and hold[c] == active[c]
        if settled:
            return
        for c in range(size):
            active[c] = hold[c]
            forces[c] = min(max(forces[c], lower[c]), upper[c])


@kernel
def walk_faces(
    matrix: Array, gap: Array, lower: Array, upper: Array, forces: Array, factor: Array, sums: Array,
    active: BoolArray,
) -> None:  # fmt: skip
    """Minimise over one face of the bounds after another.

    The force pushed off its bound most is freed next.
    """
    size, freed = len(gap), -1
    settled, goal = np.empty(size, np.bool_), np.empty(size)
    for c in range(size):
        forces[c] = min(max(0.0, lower[c]), upper[c])
        active[c] = lower[c] < forces[c] < upper[c]
        settled[c] = False
    for _ in range(FACES_PER_FORCE * size):
        if to_minimum(matrix, gap, lower, upper, forces, factor, goal, active):
            settled[:] = False
        elif freed >= 0:
            settled[freed] = True  # it does not move: the push was rounding
        sum_rows(matrix, gap, forces, sums)
        most, freed = WRONG_SIDE, -1
        for c in range(size):
            if active[c] or settled[c] or not lower[c] < upper[c]:
                continue
            push = remainder_of(matrix, gap, forces, c) / sums[c]
            if forces[c] <= lower[c]:
                push = -push
            if push > most:
                most, freed = push, c
        if freed < 0:
            return
        active[freed] = True


@kernel
def to_minimum(
    matrix: Array, gap: Array, lower: Array, upper: Array, forces: Array, factor: Array, goal: Array,
    active: BoolArray,
) -> bool:  # fmt: skip
    """Move `forces` to the minimum over the held ones, which leave `active` at a bound.

    Return whether any moved.
    """
    size, moved = len(gap), False
    for _ in range(size + 1):
        goal[:] = forces
        solve_active(matrix, gap, active, goal, factor)
        part, first = 1.0, -1
        for c in range(size):
            if active[c] and not lower[c] <= goal[c] <= upper[c]:
                bound = upper[c] if goal[c] > upper[c] else lower[c]
                share = (bound - forces[c]) / (goal[c] - forces[c])
                if first < 0 or share < part:
                    part, first = share, c
        for c in range(size):
            if active[c]:
                moved = moved or (part > 0.0 and goal[c] != forces[c])
                if first < 0:
                    forces[c] = goal[c]
                else:
                    after = forces[c] + part * (goal[c] - forces[c])
                    forces[c] = min(max(after, lower[c]), upper[c])
        if first < 0:
            break
        forces[first] = upper[first] if goal[first] > upper[first] else lower[first]
        active[first] = False
    return moved


class PressedFaces(NamedTuple):
    """Pressed faces of one surface, m of them with a nodes each.

    Attributes:
        faces: Nodes of the faces, shape (m, a).
        order: Elimination order of the faces, shape (m,).
        inside: Order of the nodes in each face of that order, shape (m, a).
        blocks: Buffer for the blocks of all pairs of nodes in that order, shape (m, a (a + 1) / 2, 3, 4);
            their diagonals and the fourth number of a row stay zero.
    """

    faces: IndexArray
    order: IndexArray
    inside: IndexArray
    blocks: Array


@kernel
def press_faces(
    stiffness: Array, surface: PressedFaces, velocities: Array, lag: float, scale: float, forces: Array
) -> None:
    """Fill the blocks of a surface, and add -lag K v to the forces (n, 3) in [N].

    Args:
        stiffness: v of the blocks, see Actuator.surface_stiffness, shape (m, 3, a, a).
        surface: The faces.
        velocities: v in [m/s], shape (n, 3).
        lag: Time lag in [s].
        scale: Factor on the blocks.
        forces: Added to.
    """
    faces, order, inside, blocks = surface.faces, surface.order, surface.inside, surface.blocks
    count, nodes = faces.shape
    for e in range(count):
        face, pair = order[e], 0
        for first in range(nodes):
            for second in range(first, nodes):
                a, b = inside[e, first], inside[e, second]
                for i in range(3):
                    j, k = (i + 1) % 3, (i + 2) % 3
                    part = scale * stiffness[face, i, a, b]
                    blocks[e, pair, j, k], blocks[e, pair, k, j] = -part, part
                pair += 1
        for a in range(nodes):
            for b in range(nodes):
                n = faces[face, b]
                for i in range(3):
                    j, k = (i + 1) % 3, (i + 2) % 3
                    turned = stiffness[face, j, a, b] * velocities[n, k]
                    turned -= stiffness[face, k, a, b] * velocities[n, j]
                    forces[faces[face, a], i] -= lag * turned


@kernel
def measure_rows(motion: Motion, rows: ActuatorRows, kinds: CompiledKinds, work: Work) -> None:
    """Compute the coordinates of the compiled kinds into rows.value; `work` must have the joints' frames."""
    measure(motion.positions, work.joint_origins, work.joint_rotations, kinds, rows.value)


@kernel
def add_rows(
    h: float, motion: Motion, rows: ActuatorRows, kinds: CompiledKinds, nodes: Nodes, tree: Tree, work: Work
) -> None:
    """Add the actuators' rows to their columns of the panels and of the reduced coordinates.

    Also predict each coordinate after h at the present velocities in rows.violation. `work` must have the
    motion subspace of the reduced coordinates.
    """
    count = len(rows.value)
    if count == 0:
        return
    measure_rows(motion, rows, kinds, work)
    fill(work.angular, work.linear, work.origin, kinds, rows.coefficient)
    size, last = len(motion.reduced_velocities), len(motion.positions)
    for c in range(count):
        column, rate = size + c, 0.0
        for e in range(rows.start[c], rows.start[c + 1]):
            n = rows.place[e]
            if n >= last:
                work.factor.schur[n - last, column] += rows.coefficient[e, 0]
                rate += rows.coefficient[e, 0] * motion.reduced_velocities[n - last]
                continue
            s, z = nodes.supernode[n], nodes.region_number[n]
            for i in range(3):
                value = rows.coefficient[e, i]
                rate += value * motion.velocities[n, i]
                if s >= 0:
                    row = nodes.first_unknown[n] + i - tree.first_column[s]
                    at = tree.panel[s] + row * tree.width[s] + nodes.reduced_column[s, column]
                    work.factor.panels[at] += value
                elif z >= 0:
                    for q in range(nodes.size[z]):
                        work.factor.schur[nodes.reduced[z, q], column] += work.jacobian[z, q, i] * value
        rows.violation[c] = rows.value[c] + h * rate


@kernel
def add_stiffness(
    stiffness: ActuatorStiffness, straining: Array, reduced_velocities: Array, nodes: Nodes, tree: Tree,
    work: Work,
) -> None:  # fmt: skip
    """Add R^T diag(w) R to the matrix, and -R^T w R v to the right-hand side for the given velocities v."""
    start, places, coefficient = stiffness.start, stiffness.place, stiffness.coefficient
    panels, supernode, unknown = work.factor.panels, nodes.supernode, nodes.first_unknown
    schur, last = work.factor.schur, len(straining)
    right = len(schur)
    moving, reduced = np.empty(right, np.int64), np.zeros(right)  # the row's reduced coordinates, its entries
    for r in range(len(stiffness.weight)):
        weight, rate, moves = stiffness.weight[r], 0.0, 0
        if weight <= 0.0:
            continue
        for e in range(start[r], start[r + 1]):
            n = places[e]
            if n >= last:
                rate += coefficient[e, 0] * reduced_velocities[n - last]
                moves = add_entry(n - last, coefficient[e, 0], moving, moves, reduced)
                continue
            for i in range(3):
                rate += coefficient[e, i] * straining[n, i]
            z = nodes.region_number[n]
            if supernode[n] >= 0 or z < 0:
                continue
            for q in range(nodes.size[z]):
                value = 0.0
                for i in range(3):
                    value += work.jacobian[z, q, i] * coefficient[e, i]
                moves = add_entry(nodes.reduced[z, q], value, moving, moves, reduced)
        for q in range(moves):
            k = moving[q]
            schur[k, right] -= weight * rate * reduced[k]
            for p in range(moves):
                if moving[p] >= k:
                    schur[k, moving[p]] += weight * reduced[k] * reduced[moving[p]]
        for e in range(start[r], start[r + 1]):
            n = places[e]
            if n >= last or supernode[n] < 0:
                continue
            s = supernode[n]
            width, columns = tree.width[s], tree.columns[s]
            row = tree.panel[s] + (unknown[n] - tree.first_column[s]) * width
            for i in range(3):
                at, value = row + i * width, weight * coefficient[e, i]
                panels[at + tree.later[s] + tree.side[s] - 1] -= rate * value
                for q in range(moves):
                    panels[at + nodes.reduced_column[s, moving[q]]] += value * reduced[moving[q]]
            for f in range(start[r], start[r + 1]):
                m = places[f]
                if m >= last or supernode[m] < 0 or unknown[m] < unknown[n]:
                    continue  # reduced, or stored in the rows of the other
                column = unknown[m] - tree.first_column[s]
                if column >= columns:  # its place among the later unknowns
                    low, high = tree.first_row[s], tree.first_row[s + 1]
                    while low < high:
                        middle = (low + high) // 2
                        if tree.row_index[middle] < unknown[m]:
                            low = middle + 1
                        else:
                            high = middle
                    column = tree.later[s] + low - tree.first_row[s]
                for i in range(3):
                    for j in range(3):
                        panels[row + i * width + column + j] += weight * coefficient[e, i] * coefficient[f, j]
        for q in range(moves):
            reduced[moving[q]] = 0.0


@inline
def add_entry(k: int, value: float, moving: IndexArray, moves: int, reduced: Array) -> int:
    """Add a value to entry k of a row with `moves` coordinates in `moving`; return their new number."""
    for q in range(moves):
        if moving[q] == k:
            reduced[k] += value
            return moves
    moving[moves] = k
    reduced[k] = value
    return moves + 1


@kernel
def hold_rows(
    h: float, lower: Array, upper: Array, change: Array, size: int, rows: ActuatorRows, matrix: Array
) -> None:
    """Solve for the multipliers within their bounds (c,), and write their effect into change[size:].

    `matrix` is the result of eliminate_reduced; rows.violation becomes s - q + c t at the end of the step.
    """
    count = len(rows.value)
    total = size + count
    for c in range(count):
        rows.violation[c] -= rows.command[c] + h * matrix[size + c, total]
        for d in range(count):
            rows.response[c, d] = -h * h * matrix[size + min(c, d), size + max(c, d)]
        rows.response[c, c] += rows.compliance[c]
    bounded_forces(rows.response, rows.violation, lower, upper, rows.multiplier)
    for c in range(count):
        change[size + c] = -h * rows.multiplier[c]
        for d in range(count):
            rows.violation[c] += rows.response[c, d] * rows.multiplier[d]


@kernel
def report_rows(h: float, motion: Motion, rows: ActuatorRows, kinds: CompiledKinds, work: Work) -> None:
    """Write multipliers as joint efforts, and the compiled kinds' values and rates as those of joints."""
    if len(rows.joint) == 0:
        return
    rows.before[:] = rows.value
    for c in range(len(rows.joint)):
        motion.joint_efforts[rows.joint[c]] = rows.multiplier[c]
    report_values(h, motion, rows, kinds, work)


@kernel
def report_values(h: float, motion: Motion, rows: ActuatorRows, kinds: CompiledKinds, work: Work) -> None:
    """Write the compiled kinds' coordinates, and their rates since rows.before, as those of their joints."""
    measure_rows(motion, rows, kinds, work)
    first = len(motion.reduced_velocities) - len(motion.joint_positions)
    for c in range(rows.compiled[0]):
        motion.joint_positions[rows.joint[c]] = rows.value[c]
        motion.reduced_velocities[first + rows.joint[c]] = (rows.value[c] - rows.before[c]) / h


@kernel
def report_impulses(
    h: float, impulses: Array, motion: Motion, rows: ActuatorRows, kinds: CompiledKinds, work: Work
) -> None:
    """Report as report_rows after impulses have been added; `impulses` (c,) are the negative ones."""
    if len(rows.joint) == 0:
        return
    for c in range(len(rows.joint)):
        motion.joint_efforts[rows.joint[c]] = rows.multiplier[c] - impulses[c] / h
    report_values(h, motion, rows, kinds, work)
