"""Elimination of the free nodes within a step: by a Cholesky factor, or by conjugate gradients.

`advance` is the whole step around a factorisation; a step with another elimination uses its parts.

Both leave the Schur complement of the reduced coordinates in `Work.factor.schur`, and panels from which
`solve_backward` computes the free nodes once the reduced coordinates are known.

The preconditioner is the factor of the matrix at rest, in single precision, rotated node by node with the
body. It depends on the parameters alone, not on earlier steps, so that a run continues from a snapshot bit by
bit. Of the matrix itself, only its own entries are stored.

The compliance of constraint rows is computed with the preconditioner, too. `correct` computes the true
response and reports the error of the first; the contact step accounts for it, see FreeMotion.defect.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from time import perf_counter
from typing import NamedTuple, Protocol

import numpy as np

from softsim_core.base import Array, FactorisationError, IndexArray
from softsim_core.physics.actuation import Actuators
from softsim_core.physics.dynamics.numba_backend.actuator_rows import (
    add_rows,
    add_stiffness,
    hold_rows,
    report_rows,
)
from softsim_core.physics.dynamics.numba_backend.cells import assemble_cells, deforming
from softsim_core.physics.dynamics.numba_backend.elements import CLAMPED, FROZEN, assemble_nodes
from softsim_core.physics.dynamics.numba_backend.kinematics import (
    advance_reduced,
    eliminate_reduced,
    jacobians,
    motion_subspace,
    place_regions,
    slides,
    solve_reduced,
    surroundings,
    turn,
)
from softsim_core.physics.dynamics.numba_backend.layout import (
    NO_STIFFNESS,
    Acting,
    Cells,
    Motion,
    StepArrays,
    StepInputs,
    kernel,
)
from softsim_core.physics.dynamics.numba_backend.prepare import Prepared, of_another_copy, shares_plan
from softsim_core.physics.dynamics.numba_backend.responses import Responses, spread_rows
from softsim_core.physics.kernels import OneSignature
from softsim_core.physics.linalg import (
    LANES,
    ROWS,
    Division,
    Factor,
    Plan,
    Preconditioner,
    Teamwork,
    Tree,
    allocate_panels,
    conjugate_gradients,
    copy_matrix,
    empty_factor,
    factor,
    forward_rows,
    forward_space,
    lead_factor,
    matrix_layout,
    matrix_of,
    reach,
    sharing_of,
    solve_backward,
    steady_seconds,
    support_factor,
    support_gradients,
    tree_of,
)
from softsim_core.physics.mechanics import Model, Rows


@kernel
def assemble(inputs: StepInputs, cells: Cells, acting: Acting | None, arrays: StepArrays) -> None:
    """Add forces, matrix and right-hand side of the step to `work`, beside those of other cells."""
    motion, h, lag = inputs.motion, inputs.h, inputs.lag
    straining, external = inputs.straining, inputs.external
    nodes, tree, work = arrays.nodes, arrays.tree, arrays.work
    x, v = motion.positions, motion.velocities
    motion_subspace(motion, arrays.kinematics, work)
    jacobians(motion, nodes, work)
    for n in range(len(x)):
        for i in range(3):
            work.forces[n, i] = external[n, i]
            work.ahead[n, i] = x[n, i] + lag * straining[n, i]
    assemble_cells(x, h * lag, CLAMPED, FROZEN, cells, nodes, work)
    assemble_nodes(v, h, inputs.rayleigh_mass, nodes, work)
    if acting is not None:
        add_rows(h, motion, acting.rows, acting.kinds, nodes, tree, work)
        add_stiffness(acting.stiffness, straining, motion.reduced_velocities, nodes, tree, work)


@kernel
def finish(inputs: StepInputs, acting: Acting | None, arrays: StepArrays) -> float:
    """Solve reduced coordinates and free nodes, advance, report joint efforts.

    Return the top speed or NaN.
    """
    motion, targets, h, lag = inputs.motion, inputs.targets, inputs.h, inputs.lag
    kinematics, nodes, tree, work = arrays.kinematics, arrays.nodes, arrays.tree, arrays.work
    joints, velocities = len(motion.joint_positions), motion.reduced_velocities
    size, right = len(velocities), len(work.factor.schur)
    first = size - joints
    prescribed = np.zeros(size, dtype=np.bool_)
    change = work.factor.solution[3 * len(nodes.free) :]
    for j in range(joints):
        b, stiffness = first + j, kinematics.stiffness[j]
        gap = targets[j] - motion.joint_positions[j]
        work.factor.schur[b, b] += kinematics.inertia[j] + h * lag * stiffness
        work.factor.schur[b, right] += h * stiffness * (gap - lag * velocities[b])
        if stiffness == 0.0:
            prescribed[b] = True
            change[b] = gap / h - velocities[b]
    if acting is not None:
        for c in range(len(acting.rows.joint)):
            change[first + acting.rows.joint[c]] = 0.0  # an actuator's joint moves no frame
    eliminate_reduced(work.factor.schur, prescribed, change, work.scratch)
    if acting is not None:
        hold_rows(h, inputs.lower, inputs.upper, change, size, acting.rows, work.scratch)
    solve_reduced(prescribed, change, work.scratch)
    solve_backward(tree, work.factor)
    speed, finite = 0.0, True
    for f in range(len(nodes.free)):
        node, place = nodes.free[f], nodes.unknown[f]
        for i in range(3):
            motion.velocities[node, i] += work.factor.solution[place + i]
            motion.positions[node, i] += h * motion.velocities[node, i]
            speed = max(speed, abs(motion.velocities[node, i]))
            finite = finite and motion.velocities[node, i] == motion.velocities[node, i]
    for j in range(joints):
        b = first + j
        if prescribed[b]:
            impulse = -work.factor.schur[b, right]
            for a in range(right):
                impulse += (work.factor.schur[a, b] if a < b else work.factor.schur[b, a]) * change[a]
            motion.joint_efforts[j] = impulse / h
    for b in range(size):
        velocities[b] += change[b]
        if slides(b, motion, kinematics):
            speed = max(speed, abs(velocities[b]))
        finite = finite and velocities[b] == velocities[b]
    advance_reduced(h, motion)
    motion.base_shift[0] = inputs.base_shift
    for j in range(joints):
        if prescribed[first + j]:
            motion.joint_positions[j] = targets[j]  # exactly, without rounding
        else:
            motion.joint_efforts[j] = kinematics.stiffness[j] * (targets[j] - motion.joint_positions[j])
    place_regions(motion, kinematics, nodes, work)
    if acting is not None:
        report_rows(h, motion, acting.rows, acting.kinds, work)
    return speed if finite else np.nan


@kernel
def advance(
    inputs: StepInputs, cells: Cells, acting: Acting | None, arrays: StepArrays
) -> tuple[float, float, float, float]:
    """Advance one whole step.

    Returns:
        The largest speed, and the seconds for assembly, factorisation and the rest.
    """
    started = steady_seconds()
    assemble(inputs, cells, acting, arrays)
    assembled = steady_seconds()
    factor(arrays.tree, arrays.work.factor)
    factored = steady_seconds()
    speed = finish(inputs, acting, arrays)
    return speed, assembled - started, factored - assembled, steady_seconds() - factored


class Elimination(Protocol):
    """Elimination of the free nodes within a step, with a direct or an iterative solver.

    Attributes:
        stages: Names of the three stages of a step.
        iterations: Conjugate gradient iterations in the last step, for all right-hand sides; 0: none.
        prepared: Arrays that a step fills in before the elimination.
        responses: Responses to forces on rows after the elimination.
    """

    stages: tuple[str, str, str]
    iterations: int
    prepared: Prepared
    responses: Responses

    def update_parameters(self, rest: Callable[[], StepInputs]) -> None:
        """Update stored data after parameters have changed.

        `rest()` returns the inputs of a step from rest, after other cells have been assembled.
        """
        ...

    def advance(self, inputs: StepInputs, acting: Acting | None) -> tuple[float, float, float, float]:
        """Advance one whole step, with the results of the kernel `advance`.

        Raises:
            FactorisationError: the step needs a factor; nothing has moved.
        """
        ...


class DirectElimination:
    """Elimination of the free nodes by a Cholesky factor, on one thread."""

    stages = ("assemble", "factor", "solve")
    iterations = 0

    def __init__(self, model: Model, actuators: Actuators, prepared: Prepared) -> None:
        self._model, self._actuators = model, actuators
        self.prepared, self.responses = prepared, Responses(model, actuators, prepared)
        self._advance, self._factor = OneSignature(advance), OneSignature(factor)

    def of_another_copy(self, model: Model, actuators: Actuators) -> DirectElimination | None:
        """Return the same elimination for another model with shared buffers.

        None: it needs a plan of its own.
        """
        own, theirs = self._actuators.constraints, actuators.constraints
        if not shares_plan(self._model, model) or any(
            not np.array_equal(a, b) for a, b in zip(own, theirs, strict=True)
        ):
            return None
        other = copy(self)
        other._model, other._actuators = model, actuators
        other.prepared = of_another_copy(self.prepared, model, actuators)
        other.responses = Responses(model, actuators, other.prepared)
        return other

    def factor(self) -> None:
        """Factor the matrix in the panels, and solve forward."""
        self._factor(self.prepared.tree, self.prepared.work.factor)

    def advance(self, inputs: StepInputs, acting: Acting | None) -> tuple[float, float, float, float]:
        """Advance one whole step, with the results of the kernel `advance`."""
        data = self.prepared
        result: tuple[float, float, float, float] = self._advance(
            inputs, data.cells.arrays, acting, data.arrays
        )
        return result

    def update_parameters(self, rest: Callable[[], StepInputs]) -> None:
        """Do nothing: a direct elimination stores nothing that depends on the parameters."""


class DividedElimination(DirectElimination):
    """Elimination by a Cholesky factor for large meshes, on several threads.

    Args:
        model, actuators: The model and its actuators.
        prepared: Arrays of a step, with a stack for the division.
        division: Division of the factorisation into parallel parts.
        threads: Number of threads.
    """

    def __init__(
        self, model: Model, actuators: Actuators, prepared: Prepared, division: Division, threads: int
    ) -> None:
        super().__init__(model, actuators, prepared)
        self._assemble, self._finish = OneSignature(assemble), OneSignature(finish)
        self._division, self._buffers = division, allocate_panels(prepared.tree, division, np.float64)
        self._factor_together = Teamwork(threads, lead_factor, support_factor)

    def factor(self) -> None:
        """Factor the matrix in the panels by several threads."""
        store = self.prepared.work.factor
        self._factor_together(self.prepared.tree, store, self._division, self._buffers)

    def advance(self, inputs: StepInputs, acting: Acting | None) -> tuple[float, float, float, float]:
        """Advance one whole step: assemble, factor by several threads, solve."""
        data, started = self.prepared, perf_counter()
        self._assemble(inputs, data.cells.arrays, acting, data.arrays)
        assembled = perf_counter()
        self.factor()
        factored = perf_counter()
        speed = self._finish(inputs, acting, data.arrays)
        return speed, assembled - started, factored - assembled, perf_counter() - factored


TOLERANCE, TOLERANCE_SHARE = 1e-8, 2e-7
"""Largest error of a node's displacement in a step, in [m] and as a share of the model's extent.

The smaller of both counts.
"""

REDUCED_SHARE = 1e-7
"""Largest relative error of the effect of frames, joints and actuators on the free nodes.

It is relative to the largest such effect.
"""

MOST_ITERATIONS = 150
"""Largest number of iterations; a step that needs more is solved by a factor."""


class _Answer(NamedTuple):
    """Solution for the eliminated free nodes, as panels [identity | border | right] for `solve_backward`.

    Attributes:
        tree: One supernode for each node.
        factor: Shares `schur` and `solution` with the matrix's.
        columns: Where each column of the border, then the right-hand side, stands, shape (3 f, d + 1).
    """

    tree: Tree
    factor: Factor
    columns: IndexArray


class IterativeElimination:
    """Elimination of the free nodes by preconditioned conjugate gradients.

    Args:
        model, actuators: The model and its actuators.
        prepared: Arrays of a step that is assembled in a `matrix_layout`.
        matrix: That layout.
        preconditioner: Plan of a factor of the free nodes' matrix.
        division: Division of the preconditioner into parallel parts.
        threads: Number of threads.
    """

    stages = ("assemble", "iterate", "solve")

    def __init__(
        self,
        model: Model,
        actuators: Actuators,
        prepared: Prepared,
        matrix: Plan,
        preconditioner: Plan,
        division: Division,
        threads: int,
    ) -> None:
        self.model, self.prepared, self.plan = model, prepared, preconditioner
        self.count, work = len(self.plan.position), prepared.work
        self.matrix = matrix_of(work.factor.panels, matrix)
        self._right = matrix.later + matrix.side - 1
        self.answer = _answer_of(self.plan.position, work.factor)
        self.answering = self.prepared._replace(
            tree=self.answer.tree, work=work._replace(factor=self.answer.factor)
        )
        position = self.plan.position
        self._around = surroundings(model, deforming(model), position)
        self.by = Preconditioner(
            tree_of(self.plan),
            np.zeros(0, np.float32),
            np.zeros((self.count, 3, 3)),
            np.zeros(3 * self.count, np.float32),
            np.zeros(int(self.plan.width.max(initial=0)) + ROWS, np.float32),
        )
        self._supernode = self.plan.supernode[np.argsort(self.plan.position)]  # by unknown
        self._sharing = sharing_of(division, 3 * self.count)
        self.responses: Responses = IterativeResponses(model, actuators, self)
        self._assemble, self._finish = OneSignature(assemble), OneSignature(finish)
        self._turn = OneSignature(turn)
        self._solve = Teamwork(threads, conjugate_gradients, support_gradients)
        self._threads = threads
        self._forward = OneSignature(forward_rows)
        extent = float(np.ptp(model.rest, axis=0).max())
        self.tolerance = min(TOLERANCE, TOLERANCE_SHARE * extent) / model.dt  # for velocities, in [m/s]
        self.iterations = 0

    def update_parameters(self, rest: Callable[[], StepInputs]) -> None:
        """Recompute the preconditioner from the matrix at rest, after parameters have changed."""
        data = self.prepared
        self._assemble(rest(), data.cells.arrays, data.acting(NO_STIFFNESS), data.arrays)
        self.by = self.by._replace(panels=np.zeros(0, np.float32))  # free the memory for the next one
        for kind in (np.float32, np.float64):  # double precision if rounding made a pivot negative
            store = empty_factor(self.plan, 0, kind)
            copy_matrix(self.matrix, self.by.tree, self._supernode, store.panels)
            buffers = allocate_panels(self.by.tree, self._sharing.division, kind)
            factor = Teamwork(self._threads, lead_factor, support_factor)
            factor(self.by.tree, store, self._sharing.division, buffers)
            self.by = self.by._replace(panels=store.panels.astype(np.float32, copy=False))
            if np.isfinite(self.by.panels.sum(dtype=np.float64)):
                return

    def advance(self, inputs: StepInputs, acting: Acting | None) -> tuple[float, float, float, float]:
        """Advance one whole step: assemble, iterate, solve.

        Raises:
            FactorisationError: nothing has moved.
        """
        data, started = self.prepared, perf_counter()
        self._assemble(inputs, data.cells.arrays, acting, data.arrays)
        assembled = perf_counter()
        self._turn(inputs.motion.positions, self._around, self.by.rotations)
        self._eliminate(self.tolerance)
        iterated = perf_counter()
        speed = self._finish(inputs, acting, self.answering.arrays)
        return speed, assembled - started, iterated - assembled, perf_counter() - iterated

    def _eliminate(self, tolerance: float) -> None:
        """Compute the Schur complement of the reduced coordinates, and the columns of the solution."""
        schur, columns = self.prepared.work.factor.schur, self._columns()
        d = len(schur)
        solved = np.empty_like(columns)
        self.iterations = 0
        for c in range(d + 1):
            limit, share = (tolerance, 0.0) if c == d else (0.0, REDUCED_SHARE)
            solved[c] = self.solve(columns[c], limit, share)
        schur -= np.triu(columns[:d] @ solved.T)
        self.answer.factor.panels[self.answer.columns] = solved.T

    def solve(self, right: Array, tolerance: float, share: float = 0.0) -> Array:
        """Return A^-1 b of the free nodes, shape (3 f,).

        Raises:
            FactorisationError: the iteration did not converge.
        """
        result = np.empty_like(right)
        count = self._solve(
            self.matrix, self.by, self._sharing, right, result, tolerance, share, MOST_ITERATIONS
        )
        if count < 0:
            raise FactorisationError("conjugate gradients did not reach the tolerance")
        self.iterations += count
        return result

    def approximate_compliance(self, unknowns: IndexArray, touching: Array) -> Array:
        """Return H M^-1 H^T with the preconditioner M, shape (r, r).

        Args:
            unknowns: Unknowns that H acts on, ascending, shape (t,).
            touching: H^T there, shape (t, r).
        """
        height = touching.shape[1]
        width = height + (-height) % LANES
        nodes, axes = np.divmod(unknowns, 3)
        whole = np.unique(nodes)
        turned = np.zeros((len(whole), 3, height))
        turned[np.searchsorted(whole, nodes), axes] = touching
        turned = self.by.rotations[whole].swapaxes(1, 2) @ turned
        scale = max(float(np.abs(turned).max(initial=0.0)), np.finfo(float).tiny)
        spread = np.zeros((3 * self.count, width), np.float32)
        spread.reshape(self.count, 3, width)[whole, :, :height] = turned / scale
        tree = self.by.tree
        spans = np.zeros((len(tree.columns), 2), np.int64)
        reach(tree, self._supernode[whole], width, spans)
        space = np.empty(forward_space(tree, width), np.float32)
        product = np.zeros((width, width), np.float32)
        store = self.prepared.work.factor._replace(panels=self.by.panels)
        self._forward(tree, store, spans, spread, space, product)
        inner = -scale * scale * product[:height, :height].astype(float)
        return np.asarray(np.triu(inner) + np.triu(inner, 1).T)

    def _columns(self) -> Array:
        """Return the columns of the reduced coordinates and the right-hand side, shape (d + 1, 3 f)."""
        d = len(self.prepared.work.factor.schur)
        result = np.zeros((d + 1, self.count, 3))
        matrix, reduced = self.matrix, self.prepared.nodes.reduced_column
        for c in range(d + 1):
            column = self._right if c == d else reduced[:, c]
            there = np.flatnonzero(column >= 0)
            at = matrix.row[there] + column[there]
            for i in range(3):
                result[c, there, i] = matrix.panels[at + i * matrix.width[there]]
        return result.reshape(d + 1, -1)


def _answer_of(position: IndexArray, matrix: Factor) -> _Answer:
    """Return panels with the identity in them; for `position` see Plan."""
    d, count = len(matrix.schur), len(position)
    all_of_it = np.stack(np.meshgrid(np.arange(count), np.arange(d)), axis=-1).reshape(-1, 2)
    layout = matrix_layout(position, np.zeros((0, 2), np.int64), all_of_it, d, LANES)
    panels = np.zeros(layout.panel[-1])
    rows = layout.panel[:-1, None] + np.arange(3) * layout.width[:, None]
    panels[rows + np.arange(3)] = 1.0
    columns = (rows + layout.later[:, None]).reshape(-1, 1) + np.arange(d + 1)
    factor_ = Factor(panels, np.zeros(0), matrix.schur, matrix.solution, np.zeros(d + 1))
    return _Answer(tree_of(layout), factor_, columns)


class IterativeResponses(Responses):
    """Responses from the preconditioner, and from conjugate gradients.

    Of the rows H, only the free nodes that they act on are stored.
    """

    def __init__(self, model: Model, actuators: Actuators, elimination: IterativeElimination) -> None:
        super().__init__(model, actuators, elimination.answering)
        self._elimination = elimination
        self._unknowns, self._touching, self._compliance = (
            np.zeros(0, np.int64),
            np.zeros((0, 0)),
            np.zeros((0, 0)),
        )
        self._spread_rows = OneSignature(spread_rows)
        self.defect = np.zeros(0)

    def _respond(self, rows: Rows, motion: Motion) -> Array:
        """Return the rows' compliance as the preconditioner approximates it."""
        free = 3 * self._elimination.count
        self._spread = np.zeros(
            (len(self.prepared.work.factor.solution), rows.height + (-rows.height) % LANES)
        )
        self._column = self._columns(rows)
        self._spread_rows(rows, self._column, motion, self.prepared.arrays, self._spread, self._spans)
        inner = self._spread[:free]
        self._unknowns = np.flatnonzero(inner.any(axis=1))
        self._touching = inner[self._unknowns].take(self._column, axis=1)
        answer = self._elimination.answer
        reached = answer.factor.panels[answer.columns[self._unknowns, :-1]]
        self._spread[free:] -= reached.T @ inner[self._unknowns]
        self._compliance = self._elimination.approximate_compliance(self._unknowns, self._touching)
        return self._compliance

    def _reach(self, impulses: Array) -> tuple[Array, Array]:
        """Solve for the response to impulses, in one column, and set the compliance's defect."""
        right = np.zeros(3 * self._elimination.count)
        right[self._unknowns] = self._touching @ impulses
        answer = self._elimination.solve(right, self._elimination.tolerance)
        self.defect = self._touching.T @ answer[self._unknowns] - self._compliance @ impulses
        column = np.zeros((len(self.prepared.work.factor.solution), LANES))
        column[: len(answer), 0] = answer
        self._spans[:] = 0, LANES
        return np.eye(1, LANES)[0], column
