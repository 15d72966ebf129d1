"""Compiled responses to forces on constraint rows, from the factor of the last step or static tangent.

With A = L L^T on the free nodes, Y = L^-1 H^T is one forward solve for all rows at once; supernodes that no
row acts on are skipped. Y^T Y is the rows' compliance with frames and joints fixed; the forces on these
reduced coordinates are computed at the same time.
"""

from __future__ import annotations

import math
from itertools import accumulate

import numpy as np

from softsim_core.base import Array, IndexArray
from softsim_core.physics.actuation import Actuators
from softsim_core.physics.actuation.compiled import CompiledKinds
from softsim_core.physics.dynamics import Condensed, Unknowns
from softsim_core.physics.dynamics.numba_backend.actuator_rows import report_impulses
from softsim_core.physics.dynamics.numba_backend.kinematics import (
    advance_reduced,
    jacobians,
    motion_subspace,
    place_regions,
    slides,
)
from softsim_core.physics.dynamics.numba_backend.layout import ActuatorRows, Motion, StepArrays, kernel
from softsim_core.physics.dynamics.numba_backend.prepare import Prepared
from softsim_core.physics.kernels import OneSignature
from softsim_core.physics.linalg import LANES, dot_product, forward_rows, forward_space, solve_backward
from softsim_core.physics.mechanics import Model, Rows, State


@kernel
def order_rows(rows: Rows, unknown: IndexArray, column: IndexArray) -> None:
    """Set the column of each row, by the first unknown that it acts on; `unknown` is Nodes.first_unknown.

    A part of the tree then meets a narrow span of columns.
    """
    first = np.full(len(column), 3 * len(unknown))  # rows of frames and joints alone come last
    for r in range(len(column)):
        for e in range(rows.start[r], rows.start[r + 1]):
            n = rows.place[e]
            if n < len(unknown) and unknown[n] >= 0:
                first[r] = min(first[r], unknown[n])
    for r in range(len(column)):
        rank = 0
        for q in range(len(column)):
            rank += first[q] < first[r] or (first[q] == first[r] and q < r)
        column[r] = rank


@kernel
def spread_rows(
    rows: Rows, column: IndexArray, motion: Motion, arrays: StepArrays, spread: Array, spans: IndexArray
) -> None:
    """Write H^T into `spread` (unknowns, padded rows), row r in column[r], and the supernodes' spans."""
    start, place, coefficient = rows.start, rows.place, rows.coefficient
    nodes, tree, work = arrays.nodes, arrays.tree, arrays.work
    motion_subspace(motion, arrays.kinematics, work)
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
    rows: Rows, column: IndexArray, motion: Motion, arrays: StepArrays, spread: Array, spans: IndexArray,
    space: Array, product: Array, result: Array,
) -> None:  # fmt: skip
    """Compute H^T and Y of all rows, and Y^T Y in their own order into `result` (r, r)."""
    spread_rows(rows, column, motion, arrays, spread, spans)
    forward_rows(arrays.tree, arrays.work.factor, spans, spread, space, product)
    for r in range(len(column)):
        for q in range(r + 1):
            value = -product[min(column[r], column[q]), max(column[r], column[q])]
            result[r, q] = value
            result[q, r] = value


@kernel
def let_reduced_move(
    upper: Array, solved: IndexArray, tail: Array, column: IndexArray, schur: Array, arriving: Array,
    answer: Array, compliance: Array,
) -> None:  # fmt: skip
    """Complete the compliance of contacts by actuators, and by the motion of frames and joints.

    Args:
        upper: Upper triangle of the Schur complement of b frames and joints and c actuators (d, d + 1).
        solved: Frames and joints whose motion is not prescribed, shape (s,).
        tail: Rows of _spread for frames, joints and actuators, shape (d, padded rows).
        column: Column of each of r rows in `tail`.
        schur: Filled: the whole Schur complement, shape (d, d).
        arriving: Filled: forces on frames and joints of actuators and rows, shape (b, c + r).
        answer: Filled: what moves of them, shape (b, c + r).
        compliance: The contacts' block is filled and frames and joints are fixed; completed, (c + r, c + r).
    """
    size, count = len(arriving), len(schur) - len(arriving)
    for a in range(len(schur)):
        for b in range(len(schur)):
            schur[a, b] = upper[min(a, b), max(a, b)]
    for i in range(count):
        for j in range(count):
            compliance[i, j] = -schur[size + i, size + j]
        for r in range(len(column)):
            compliance[i, count + r] = compliance[count + r, i] = -tail[size + i, column[r]]
    for b in range(size):
        for i in range(count):
            arriving[b, i] = schur[b, size + i]
        for r in range(len(column)):
            arriving[b, count + r] = tail[b, column[r]]
    factor = np.empty((len(solved), len(solved)))  # L D L^T, with D on the diagonal
    answer[:] = 0.0
    for a in range(len(solved)):
        for b in range(a + 1):
            value = schur[solved[a], solved[b]]
            for k in range(b):
                value -= factor[a, k] * factor[b, k] * factor[k, k]
            factor[a, b] = value / factor[b, b] if b < a else value
        answer[solved[a]] = arriving[solved[a]]
        for k in range(a):
            answer[solved[a]] -= factor[a, k] * answer[solved[k]]
    for a in range(len(solved)):
        for q in range(compliance.shape[1]):
            half = answer[solved[a], q] / factor[a, a]
            for p in range(compliance.shape[1]):
                compliance[p, q] += answer[solved[a], p] * half
    for a in range(len(solved) - 1, -1, -1):
        answer[solved[a]] /= factor[a, a]
        for k in range(a + 1, len(solved)):
            answer[solved[a]] -= factor[k, a] * answer[solved[k]]


@kernel
def apply_impulses(
    motion: Motion, before: Motion, impulses: Array, reduced_change: Array, h: float, rows: ActuatorRows,
    kinds: CompiledKinds, arrays: StepArrays, spread: Array, spans: IndexArray,
) -> float:  # fmt: skip
    """Change velocities and positions by impulses (padded rows); return the top speed, or NaN.

    `reduced_change` (b + c,) has the change of frames and joints, then minus the impulses of actuators.
    """
    kinematics, nodes, tree, work = arrays.kinematics, arrays.nodes, arrays.tree, arrays.work
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
            motion.joint_positions[j] = turning[j]  # exactly its target
    place_regions(motion, kinematics, nodes, work)
    report_impulses(h, reduced_change[size:], motion, rows, kinds, work)
    return speed if finite else np.nan


class Responses:
    """Responses from the factor in the panels; between calls, it stores only buffers.

    Args:
        model, actuators: The model and its actuators.
        prepared: Arrays of its stepper.

    Attributes:
        defect: See FreeMotion.
    """

    defect: Array | None = None

    def __init__(self, model: Model, actuators: Actuators, prepared: Prepared) -> None:
        self.model, self.actuators, self.prepared = model, actuators, prepared
        self._plain = len(actuators) > int(prepared.rows.compiled[0])
        self._upper = np.triu(np.ones((model.reduced_size + len(actuators),) * 2, dtype=bool))
        at = Unknowns(model)
        self._first, self._prescribed = at.first_reduced, at.prescribed
        self._solved = np.setdiff1d(np.arange(model.reduced_size), at.fixed - at.first_reduced)
        self._spans = np.zeros((len(prepared.tree.columns), 2), dtype=np.int64)
        self._spread = self._arriving = self._answer = self._schur = np.zeros((0, 0))
        self._column, self._buffer = np.zeros(0, np.int64), np.zeros(0)
        self._respond_to, self._apply = OneSignature(respond), OneSignature(apply_impulses)
        self._order_rows = OneSignature(order_rows)
        self._let_reduced_move = OneSignature(let_reduced_move)

    def positive(self) -> bool:
        """Return whether the free nodes' matrix had positive pivots.

        Other pivots leave a NaN in later entries.
        """
        panels = self.prepared.work.factor.panels  # without frames, there is no Schur complement to check
        return bool(np.isfinite(self._read_schur_complement()).all() and np.isfinite(panels).all())

    def compliance(self, rows: Rows, before: Motion) -> Array:
        """Return FreeMotion.compliance; `before` is the state at the start of the step."""
        size, acting = self.model.reduced_size, len(self.actuators)
        compliance = np.empty((acting + rows.height,) * 2)
        compliance[acting:, acting:] = self._respond(rows, before)
        self._schur = np.empty((size + acting,) * 2)
        self._arriving, self._answer = np.empty((2, size, acting + rows.height))
        self._let_reduced_move(
            self.prepared.work.factor.schur, self._solved, self._spread[self._first :], self._column,
            self._schur, self._arriving, self._answer, compliance,
        )  # fmt: skip
        return compliance

    def correct(self, state: State, before: State, impulses: Array) -> float:
        """Add the response to impulses to the free motion in `state`.

        Return the top speed, NaN if one is NaN.
        """
        model, data, acting = self.model, self.prepared, len(self.actuators)
        change = self._answer @ impulses
        free = state.joint_positions.copy()
        placed, spread = self._reach(impulses[acting:])
        speed = self._apply(
            motion_of(state), motion_of(before), placed, np.concatenate([change, -impulses[:acting]]),
            model.dt, data.rows, data.kinds, data.arrays, spread, self._spans,
        )  # fmt: skip
        if len(free):
            first, prescribed = model.reduced_size - len(free), self._prescribed
            schur = self._schur[first : model.reduced_size, : model.reduced_size]
            reaction = (schur @ change - self._arriving[first:] @ impulses) / model.dt
            state.joint_efforts[prescribed] += reaction[prescribed]
            state.joint_efforts -= data.kinematics.stiffness * (state.joint_positions - free)
            self.actuators.set_multipliers(state, data.rows.multiplier + impulses[:acting] / model.dt)
        if self._plain:
            self.actuators.report(model, state, data.rows.before, self.actuators.multipliers(state))
        return float(speed)

    def condense(self, rows: Rows, motion: Motion) -> Condensed:
        """Return StaticTangent.condense; `motion` is the state at which the tangent was taken."""
        size = self.model.reduced_size
        stiffness = self._read_schur_complement()[:size, :size]
        if not rows.height:
            return Condensed(stiffness, np.zeros((size, 0)), np.zeros((0, 0)))
        compliance = self._respond(rows, motion)
        return Condensed(stiffness, self._spread[self._first : self._first + size, self._column], compliance)

    def _respond(self, rows: Rows, motion: Motion) -> Array:
        """Return H A^-1 H^T with frames and joints fixed, (r, r).

        Store Y and the forces on these in _spread.
        """
        data = self.prepared
        padded = rows.height + (-rows.height) % LANES
        unknowns, space = len(data.work.factor.solution), forward_space(data.tree, padded)
        self._spread, buffer, product = self._take_buffers((unknowns, padded), (space,), (padded, padded))
        self._column, result = self._columns(rows), np.empty((rows.height, rows.height))
        self._respond_to(
            rows, self._column, motion, data.arrays, self._spread, self._spans, buffer, product, result
        )
        return result

    def _reach(self, impulses: Array) -> tuple[Array, Array]:
        """Return impulses (r,) by the column of each row, and these columns of L^-1 H^T."""
        placed = np.zeros(self._spread.shape[1])
        placed[self._column] = impulses
        return placed, self._spread

    def _columns(self, rows: Rows) -> IndexArray:
        """Return the column of each row; see order_rows."""
        column = np.empty(rows.height, dtype=np.int64)
        self._order_rows(rows, self.prepared.nodes.first_unknown, column)
        return column

    def _take_buffers(self, *shapes: tuple[int, ...]) -> list[Array]:
        """Return uninitialised buffers, which are reused by the next call and grow as needed."""
        sizes = [math.prod(shape) for shape in shapes]
        if sum(sizes) > len(self._buffer):
            self._buffer = np.empty(2 * sum(sizes))
        ends = accumulate(sizes)
        return [
            self._buffer[end - size : end].reshape(shape)
            for end, size, shape in zip(ends, sizes, shapes, strict=True)
        ]

    def _read_schur_complement(self) -> Array:
        """Return the whole Schur complement of the free nodes, shape (b + c, b + c)."""
        schur = self.prepared.work.factor.schur[:, :-1]
        return np.where(self._upper, schur, schur.T)


def motion_of(state: State) -> Motion:
    """Return the state's arrays for the kernels."""
    return Motion(*(getattr(state, name) for name in Motion._fields))
