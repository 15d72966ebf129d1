"""Interface of linear solvers (plan a pattern once, factor values, solve), and its implementation by SuperLU.

Each stage is an object that the previous stage returns, so that the types enforce the order of calls. A
solver that is registered by a name (see linalg.solvers) runs wherever a scene selects it: in the step, in
statics and in static tangents.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, TypeAlias

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from softsim_core.base import Array, FactorisationError, IndexArray

Rows: TypeAlias = "sp.csr_matrix | Array"
"""Rows (r, d), sparse or dense."""


@dataclass(frozen=True, slots=True, eq=False)
class Pattern:
    """Pattern of a symmetric matrix: both triangles, column by column, rows ascending in each.

    Attributes:
        size: Number of unknowns d.
        dense: Number of unknowns, at the end, coupled to many others (frames and joints); best eliminated
            last, as a dense block.
        starts: First entry of each column, and the end of the last column, shape (d + 1,).
        rows: Row of each entry, shape (k,).
    """

    size: int
    dense: int
    starts: IndexArray
    rows: IndexArray

    def matrix(self, values: Array) -> sp.csc_matrix:
        """Return the matrix with `values` (k,) at the entries."""
        return sp.csc_matrix((values, self.rows, self.starts), shape=(self.size, self.size))

    def columns(self) -> IndexArray:
        """Return the column of each entry, shape (k,)."""
        return np.repeat(np.arange(self.size), np.diff(self.starts))


class LinearSolver(Protocol):
    """Solver of symmetric linear systems that share one pattern."""

    @property
    def name(self) -> str:
        """Name used in scenes."""
        ...

    def plan(self, pattern: Pattern) -> SolverPlan:
        """Return everything that depends on the pattern only: an order and buffers.

        Raises:
            SceneError: the solver cannot run here because a package is missing.
        """
        ...


class SolverPlan(Protocol):
    """Linear solver planned for one pattern."""

    def factor(self, values: Array) -> Factors:
        """Factor the matrix with finite `values` (k,) [any unit] in the order of the pattern's entries.

        Raises:
            FactorisationError: the matrix is singular: a pivot is zero.
        """
        ...


class Factors(Protocol):
    """Factors of one matrix A, valid until their plan factors another one."""

    @property
    def positive(self) -> bool:
        """Whether A was found positive definite. If it was not, the other results may be NaN."""
        ...

    def solve(self, right: Array) -> Array:
        """Return A^-1 B for B of shape (d,) or (d, k), same shape."""
        ...

    def schur(self, rows: Rows) -> Array:
        """Return H A^-1 H^T of rows H (r, d), sparse or dense; symmetric, shape (r, r)."""
        ...


def spread_of(rows: Rows) -> Array:
    """Return H^T (d, r) of rows H (r, d), dense."""
    return np.asarray(rows.T if isinstance(rows, np.ndarray) else rows.T.toarray())


class Factoriser:
    """Factoriser of sparse matrices with one solver; it plans again only when the pattern changes.

    Args:
        solver: The linear solver.
        dense: See Pattern.
    """

    def __init__(self, solver: LinearSolver, dense: int = 0) -> None:
        self._solver, self._dense = solver, dense
        self._pattern: Pattern | None = None
        self._plan: SolverPlan | None = None

    def factor(self, matrix: sp.spmatrix) -> Factors:
        """Return the factors of a (nearly) symmetric matrix (d, d).

        Raises:
            FactorisationError: it is singular, or has a number that is not finite.
        """
        columns = sp.csc_matrix(matrix)
        columns.sum_duplicates()  # also sorts each column
        if not np.isfinite(columns.data).all():
            raise FactorisationError("the matrix holds a number that is not finite")
        pattern = self._pattern
        if pattern is None or not (
            np.array_equal(pattern.starts, columns.indptr) and np.array_equal(pattern.rows, columns.indices)
        ):
            starts, rows = columns.indptr.astype(np.int64), columns.indices.astype(np.int64)
            pattern = self._pattern = Pattern(columns.shape[0], self._dense, starts, rows)
            self._plan = self._solver.plan(pattern)
        assert self._plan is not None
        return self._plan.factor(columns.data)


class SuperLU:
    """Linear solver by SciPy's SuperLU; it needs no further package."""

    name = "superlu"

    def plan(self, pattern: Pattern) -> SuperLUPlan:
        """Return the plan for a pattern."""
        return SuperLUPlan(pattern)


class SuperLUPlan:
    """Plan of SuperLU for one pattern; SuperLU computes a new order for each matrix."""

    def __init__(self, pattern: Pattern) -> None:
        self._pattern = pattern

    def factor(self, values: Array) -> SuperLUFactors:
        """Factor the matrix with `values` (k,) in the order of the pattern's entries."""
        return SuperLUFactors(factorise_matrix(self._pattern.matrix(values)))


class SuperLUFactors:
    """Factors of SuperLU; they remain valid after their plan factors another matrix."""

    def __init__(self, factors: Any) -> None:
        self._factors = factors

    @cached_property
    def positive(self) -> bool:
        """Whether all pivots are positive and on the diagonal, so that A is positive definite."""
        factors = self._factors
        return bool((factors.U.diagonal() > 0.0).all()) and bool((factors.perm_r == factors.perm_c).all())

    def solve(self, right: Array) -> Array:
        """Return A^-1 B for B of shape (d,) or (d, k), same shape."""
        return np.asarray(self._factors.solve(right))

    def schur(self, rows: Rows) -> Array:
        """Return H A^-1 H^T of rows H (r, d), symmetric, shape (r, r)."""
        spread = spread_of(rows)
        product = spread.T @ self._factors.solve(spread)
        return np.asarray(0.5 * (product + product.T))


def factorise_matrix(matrix: sp.csc_matrix) -> Any:
    """Return SuperLU factors of a (nearly) symmetric matrix.

    Pivots stay on the diagonal; the order is the minimum degree order of A + A^T.

    Raises:
        FactorisationError: the matrix is singular.
    """
    options = {"SymmetricMode": True}
    try:
        return splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    except RuntimeError as error:
        raise FactorisationError(f"the matrix has no factors: {error}") from error
