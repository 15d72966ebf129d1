"""Compiled kernels of the rows of actuators, whatever their kind.

A row H stands as one more column of the reduced coordinates in the panels, so that factoring the step's
matrix brings H A^-1 H^T beside everything else; see reduced. Kinds without compiled kernels have their values
and coefficients filled in before.
"""

from __future__ import annotations

from softsim_core.actuation.compiled.kinds import CompiledKinds, fill, measure
from softsim_core.arrays import Array
from softsim_core.dynamics.numba_backend.bounded import bounded_forces
from softsim_core.dynamics.numba_backend.compile import kernel
from softsim_core.dynamics.numba_backend.layout import (
    ActuatorRows,
    ActuatorStiffness,
    Motion,
    Nodes,
    Work,
)
from softsim_core.linalg.layout import Tree


@kernel
def measure_rows(motion: Motion, rows: ActuatorRows, kinds: CompiledKinds, work: Work) -> None:
    """Coordinates of the compiled kinds into rows.value; the frames of the joints have to be in `work`."""
    measure(motion.positions, work.joint_origins, work.joint_rotations, kinds, rows.value)


@kernel
def add_rows(
    h: float, motion: Motion, rows: ActuatorRows, kinds: CompiledKinds, nodes: Nodes, tree: Tree, work: Work
) -> None:
    """Rows of actuators into their columns of panels and reduced; into rows.violation where s drifts.

    That is the coordinate after h at the present velocities. The motion subspace of the reduced
    coordinates has to be in `work`.
    """
    count = len(rows.joint)
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
    """Add R^T diag(w) R to the matrix, and -R^T w R v to the right-hand side, v the velocities given."""
    start, places, coefficient = stiffness.start, stiffness.place, stiffness.coefficient
    panels, supernode, unknown = work.factor.panels, nodes.supernode, nodes.first_unknown
    last = len(straining)
    for r in range(len(stiffness.weight)):
        weight, rate = stiffness.weight[r], 0.0
        if weight <= 0.0:
            continue
        for e in range(start[r], start[r + 1]):
            n = places[e]
            if n >= last:
                rate += coefficient[e, 0] * reduced_velocities[n - last]
                continue
            for i in range(3):
                rate += coefficient[e, i] * straining[n, i]
        for e in range(start[r], start[r + 1]):
            n = places[e]
            if n >= last or supernode[n] < 0:
                _add_border(weight, rate, e, start[r], start[r + 1], stiffness, last, nodes, work)
                continue
            s = supernode[n]
            width, columns = tree.width[s], tree.columns[s]
            row = tree.panel[s] + (unknown[n] - tree.first_column[s]) * width
            for i in range(3):
                panels[row + i * width + tree.later[s] + tree.side[s] - 1] -= (
                    weight * rate * coefficient[e, i]
                )
            for f in range(start[r], start[r + 1]):
                m = places[f]
                if m >= last or supernode[m] < 0:
                    for p in range(_count(m, last, nodes)):
                        k, value = _reduced(f, p, stiffness, last, nodes, work)
                        for i in range(3):
                            at = row + i * width + nodes.reduced_column[s, k]
                            panels[at] += weight * coefficient[e, i] * value
                    continue
                if unknown[m] < unknown[n]:
                    continue  # stands in the rows of the other
                column = unknown[m] - tree.first_column[s]
                if column >= columns:  # its place among the later ones
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


@kernel
def _add_border(
    weight: float, rate: float, e: int, begin: int, end: int, stiffness: ActuatorStiffness, last: int,
    nodes: Nodes, work: Work,
) -> None:  # fmt: skip
    """What entry e adds for the reduced coordinates that it moves with, beside entries begin to end."""
    schur, right = work.factor.schur, len(work.factor.schur)
    for q in range(_count(stiffness.place[e], last, nodes)):
        k, value = _reduced(e, q, stiffness, last, nodes, work)
        schur[k, right] -= weight * rate * value
        for f in range(begin, end):
            place = stiffness.place[f]
            if place < last and nodes.supernode[place] >= 0:
                continue
            for p in range(_count(place, last, nodes)):
                m, other = _reduced(f, p, stiffness, last, nodes, work)
                if m >= k:
                    schur[k, m] += weight * value * other


@kernel
def _count(place: int, last: int, nodes: Nodes) -> int:
    """How many reduced coordinates a place that is no free node moves with."""
    if place >= last:
        return 1
    z = nodes.region_number[place]
    return int(nodes.size[z]) if z >= 0 else 0


@kernel
def _reduced(
    e: int, q: int, stiffness: ActuatorStiffness, last: int, nodes: Nodes, work: Work
) -> tuple[int, float]:
    """The q-th of them for entry e, and the entry's coefficient of it."""
    place = stiffness.place[e]
    if place >= last:
        return place - last, stiffness.coefficient[e, 0]
    z, total = nodes.region_number[place], 0.0
    for i in range(3):
        total += work.jacobian[z, q, i] * stiffness.coefficient[e, i]
    return nodes.reduced[z, q], total


@kernel
def hold_rows(
    h: float, targets: Array, lower: Array, upper: Array, change: Array, size: int, rows: ActuatorRows,
    matrix: Array,
) -> None:  # fmt: skip
    """Multipliers within their bounds (c,), and what they are to the kinematics, into change[size:].

    `matrix` is what eliminate_reduced left; rows.violation becomes s - q + c t at the end of the step.
    """
    count = len(rows.joint)
    total = size + count
    for c in range(count):
        rows.violation[c] -= targets[rows.joint[c]] + h * matrix[size + c, total]
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
    """Multipliers as joint efforts, coordinates of the compiled kinds and their rates as those of joints."""
    if len(rows.joint) == 0:
        return
    for c in range(len(rows.joint)):
        motion.joint_efforts[rows.joint[c]] = rows.multiplier[c]
        rows.before[c] = rows.value[c]
    report_values(h, motion, rows, kinds, work)


@kernel
def report_values(h: float, motion: Motion, rows: ActuatorRows, kinds: CompiledKinds, work: Work) -> None:
    """Coordinates of the compiled kinds, and their rates since rows.before, as those of their joints."""
    measure_rows(motion, rows, kinds, work)
    first = len(motion.reduced_velocities) - len(motion.joint_positions)
    for c in range(rows.compiled[0]):
        motion.joint_positions[rows.joint[c]] = rows.value[c]
        motion.reduced_velocities[first + rows.joint[c]] = (rows.value[c] - rows.before[c]) / h


@kernel
def report_impulses(
    h: float, impulses: Array, motion: Motion, rows: ActuatorRows, kinds: CompiledKinds, work: Work
) -> None:
    """As report_rows, after impulses have come on top; `impulses` (c,) holds minus them."""
    if len(rows.joint) == 0:
        return
    for c in range(len(rows.joint)):
        motion.joint_efforts[rows.joint[c]] = rows.multiplier[c] - impulses[c] / h
    report_values(h, motion, rows, kinds, work)
