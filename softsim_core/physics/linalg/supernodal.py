"""Compiled supernodal multifrontal Cholesky factorisation as a LinearSolver.

The compiled step fills the panels of the same plan without an intermediate sparse matrix. A matrix that is
not positive definite has no Cholesky factor; it is factored by SuperLU.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from softsim_core.base import Array, IndexArray, SceneError, unique_pairs
from softsim_core.physics.linalg.solver_interface import (
    Factors,
    Pattern,
    Rows,
    SolverPlan,
    SuperLUFactors,
    factorise_matrix,
    spread_of,
)


class Supernodal:
    """Linear solver by a supernodal Cholesky factor; it needs Numba."""

    name = "supernodal"

    def plan(self, pattern: Pattern) -> SolverPlan:
        """Return the plan for a pattern.

        Raises:
            SceneError: the package numba is missing.
        """
        try:
            return SupernodalPlan(pattern)
        except ModuleNotFoundError as error:
            if error.name is None or error.name.split(".")[0] not in ("numba", "llvmlite"):
                raise
            raise SceneError(
                "linear solver supernodal needs the package numba: pip install numba, or use superlu"
            ) from error


class Iterative(Supernodal):
    """Name that selects conjugate gradients in the compiled step; single matrices are factored."""

    name = "iterative"


class _Slots(NamedTuple):
    """Places of a pattern's entries.

    Entry `panel_entry[i]` goes to panels[panel_place[i]]; the same holds for schur.
    """

    panel_entry: IndexArray
    panel_place: IndexArray
    schur_entry: IndexArray
    schur_place: IndexArray


class SupernodalPlan:
    """Plan of the supernodal solver: unknowns in blocks of three, padded to a multiple of three."""

    def __init__(self, pattern: Pattern) -> None:
        from softsim_core.physics.linalg import cholesky
        from softsim_core.physics.linalg.instructions import LANES, ROWS
        from softsim_core.physics.linalg.symbolic import empty_factor, plan, tree_of

        self.kernels, self.lanes = cholesky, LANES
        self.pattern, self.sparse = pattern, pattern.size - pattern.dense
        self.count = -(-self.sparse // 3)
        rows, columns = pattern.rows, pattern.columns()
        inside = (rows < self.sparse) & (columns < self.sparse)
        edges = unique_pairs(np.stack([rows[inside] // 3, columns[inside] // 3], axis=1))
        beside = (rows < self.sparse) & (columns >= self.sparse)
        pairs = np.stack([rows[beside] // 3, columns[beside] - self.sparse], axis=1)
        layout = plan(self.count, edges, unique_pairs(pairs), pattern.dense, LANES, ROWS)
        self.tree, self.store = tree_of(layout), empty_factor(layout, pattern.dense)
        blocks, axes = np.divmod(np.arange(3 * self.count), 3)
        self.place = np.empty(self.count * 3 + pattern.dense, dtype=np.int64)  # by unknown, pads included
        self.place[: 3 * self.count] = 3 * layout.position[blocks] + axes
        self.place[3 * self.count :] = np.arange(3 * self.count, len(self.place))
        self.unknown = np.r_[: self.sparse, 3 * self.count : len(self.place)]  # without pads
        self.supernode = np.zeros(len(self.place), dtype=np.int64)  # by place
        self.supernode[self.place[: 3 * self.count]] = layout.supernode[blocks]
        stride = layout.width[layout.supernode]
        self.slots, own = self._slots(layout, rows, columns, stride)
        self.diagonal = own[: self.sparse]
        self.pads = own[self.sparse :]

    def _slots(
        self, layout: Any, rows: IndexArray, columns: IndexArray, stride: IndexArray
    ) -> tuple[_Slots, IndexArray]:
        """Return the slots of the entries, and the diagonals' panel places.

        These are the places of each sparse unknown's diagonal, pads included.
        """

        def panel_place(first: IndexArray, later: IndexArray) -> IndexArray:
            block, axis = np.divmod(first, 3)
            column = layout.panel_columns(layout.supernode[block], self.place[later])
            return np.asarray(layout.row_offset[block] + axis * stride[block] + column)

        tail = 3 * self.count - self.sparse
        a, b = rows + tail * (rows >= self.sparse), columns + tail * (columns >= self.sparse)
        upper = self.place[a] <= self.place[b]
        in_panel = upper & (rows < self.sparse)
        in_schur = upper & (rows >= self.sparse)
        own = np.arange(3 * self.count)
        d, first = self.pattern.dense, 3 * self.count
        panel, schur = np.flatnonzero(in_panel), np.flatnonzero(in_schur)
        slots = _Slots(
            panel, panel_place(a[panel], b[panel]), schur, (a[schur] - first) * (d + 1) + b[schur] - first
        )
        return slots, panel_place(own, own)

    def factor(self, values: Array) -> Factors:
        """Factor the matrix with `values` (k,), by SuperLU if it is not positive definite."""
        store, slots = self.store, self.slots
        store.panels[:] = 0.0
        store.schur[:] = 0.0
        store.panels[slots.panel_place] = values[slots.panel_entry]
        store.panels[self.pads] = 1.0
        store.schur.reshape(-1)[slots.schur_place] = values[slots.schur_entry]
        self.kernels.factor(self.tree, store)
        pivots = store.panels[self.diagonal]
        if (pivots > 0.0).all() and np.isfinite(pivots).all():
            try:
                return SupernodalFactors(self, cho_factor(store.schur[:, :-1]))
            except (np.linalg.LinAlgError, ValueError):  # the dense block is not positive
                pass
        return _NotPositive(factorise_matrix(self.pattern.matrix(values)))


class _NotPositive(SuperLUFactors):
    """SuperLU factors of a matrix that is not positive definite."""

    @property
    def positive(self) -> bool:
        """False: the matrix is not positive definite."""
        return False


class SupernodalFactors:
    """Supernodal Cholesky factors of a positive definite matrix."""

    positive = True

    def __init__(self, plan: SupernodalPlan, last: tuple[Array, bool]) -> None:
        self._plan, self._last = plan, last

    def solve(self, right: Array) -> Array:
        """Return A^-1 B for B of shape (d,) or (d, k), same shape."""
        columns = right.reshape(len(right), -1)
        spread, _ = self._forward(columns)
        plan, first = self._plan, 3 * self._plan.count
        spread[first:] = cho_solve(self._last, spread[first:])
        plan.kernels.solve_columns(plan.tree, plan.store, spread, columns.shape[1])
        return np.asarray(spread[plan.place[plan.unknown], : columns.shape[1]].reshape(right.shape))

    def schur(self, rows: Rows) -> Array:
        """Return H A^-1 H^T of rows H (r, d), shape (r, r): Y^T Y with A = L L^T and Y = L^-1 H^T."""
        spread, product = self._forward(spread_of(rows))
        count, first = rows.shape[0], 3 * self._plan.count
        inner = -product[:count, :count]
        last = spread[first:, :count]
        outer = last.T @ cho_solve(self._last, last)
        return np.asarray(np.triu(inner) + np.triu(inner, 1).T + 0.5 * (outer + outer.T))

    def _forward(self, columns: Array) -> tuple[Array, Array]:
        """Return L^-1 of columns (d, k), by place and padded, and -Y^T Y (upper triangle)."""
        plan = self._plan
        tree, width = plan.tree, columns.shape[1] + (-columns.shape[1]) % plan.lanes
        spread = np.zeros((len(plan.place), width))
        spread[plan.place[plan.unknown], : columns.shape[1]] = columns
        product = np.zeros((width, width))
        space = np.empty(plan.kernels.forward_space(tree, width))
        plan.kernels.forward_rows(tree, plan.store, self._spans(spread), spread, space, product)
        return spread, product

    def _spans(self, spread: Array) -> IndexArray:
        """Return the first and last column that reach each supernode, in whole vectors, shape (s, 2)."""
        plan, width = self._plan, spread.shape[1]
        tree, first = plan.tree, 3 * plan.count
        spans = np.zeros((len(tree.columns), 2), dtype=np.int64)
        spans[:, 0] = width
        place, column = np.nonzero(spread[:first])
        low = column - column % plan.lanes
        np.minimum.at(spans[:, 0], plan.supernode[place], low)
        np.maximum.at(spans[:, 1], plan.supernode[place], low + plan.lanes)
        for s, p in enumerate(tree.parent.tolist()):  # children precede their parents
            if p >= 0:
                spans[p, 0] = min(spans[p, 0], spans[s, 0])
                spans[p, 1] = max(spans[p, 1], spans[s, 1])
        return spans
