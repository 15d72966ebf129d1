"""The seam of linear solvers (plan a pattern once, factor values, solve), and SciPy's SuperLU behind it.

Each stage is an object that the one before it gives, so that the order of calls is in the types. A solver
that is registered by a name (see linalg.solvers) runs wherever a scene asks for it: in the step, in statics
and in static tangents.
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
    """Where a symmetric matrix may hold entries: both triangles, column by column, rows ascending in each.

    Attributes:
        size: Number of unknowns d.
        dense: How many of them, the last ones, are coupled to many others (frames and joints): best
            eliminated last, as a dense block.
        starts: Where the entries of each column begin; the last one ends them, shape (d + 1,).
        rows: Row of each entry, shape (k,).
    """

    size: int
    dense: int
    starts: IndexArray
    rows: IndexArray

    def matrix(self, values: Array) -> sp.csc_matrix:
        """The matrix with `values` (k,) at the entries."""
        return sp.csc_matrix((values, self.rows, self.starts), shape=(self.size, self.size))

    def columns(self) -> IndexArray:
        """Column of each entry, shape (k,)."""
        return np.repeat(np.arange(self.size), np.diff(self.starts))


class LinearSolver(Protocol):
    """A way to solve symmetric linear systems with the same pattern again and again."""

    @property
    def name(self) -> str:
        """By which scenes choose it."""
        ...

    def plan(self, pattern: Pattern) -> SolverPlan:
        """Everything that depends on the pattern only: an order, room to work in.

        Raises:
            SceneError: it cannot run here, a package is missing.
        """
        ...


class SolverPlan(Protocol):
    """A solver that knows the pattern."""

    def factor(self, values: Array) -> Factors:
        """Factor the matrix with `values` (k,) [any unit] in the order of the pattern's entries, all finite.

        Raises:
            FactorisationError: the matrix is singular: a pivot is zero.
        """
        ...


class Factors(Protocol):
    """What answers for one matrix A; it stands until its plan factors another one."""

    @property
    def positive(self) -> bool:
        """Whether A was found positive definite. Where it was not, the other answers may be NaN."""
        ...

    def solve(self, right: Array) -> Array:
        """A^-1 B for B of shape (d,) or (d, k), same shape."""
        ...

    def schur(self, rows: Rows) -> Array:
        """H A^-1 H^T of rows H (r, d), sparse or dense; symmetric, shape (r, r)."""
        ...


def spread_of(rows: Rows) -> Array:
    """H^T (d, r) of rows H (r, d), dense."""
    return np.asarray(rows.T if isinstance(rows, np.ndarray) else rows.T.toarray())


class Factoriser:
    """Factors sparse matrices with one solver; it plans anew only when the pattern changes.

    Args:
        solver: Which.
        dense: See Pattern.
    """

    def __init__(self, solver: LinearSolver, dense: int = 0) -> None:
        self._solver, self._dense = solver, dense
        self._pattern: Pattern | None = None
        self._plan: SolverPlan | None = None

    def factor(self, matrix: sp.spmatrix) -> Factors:
        """Factors of a (nearly) symmetric matrix (d, d).

        Raises:
            FactorisationError: it is singular, or holds a number that is not finite.
        """
        columns = sp.csc_matrix(matrix)
        columns.sum_duplicates()  # sorts each column as well
        if not np.isfinite(columns.data).all():
            raise FactorisationError("the matrix holds a number that is not finite")
        known = self._pattern
        if known is None or not (
            np.array_equal(known.starts, columns.indptr) and np.array_equal(known.rows, columns.indices)
        ):
            starts, rows = columns.indptr.astype(np.int64), columns.indices.astype(np.int64)
            known = self._pattern = Pattern(columns.shape[0], self._dense, starts, rows)
            self._plan = self._solver.plan(known)
        assert self._plan is not None
        return self._plan.factor(columns.data)


class SuperLU:
    """See LinearSolver; it runs everywhere."""

    name = "superlu"

    def plan(self, pattern: Pattern) -> SuperLUPlan:
        """See LinearSolver."""
        return SuperLUPlan(pattern)


class SuperLUPlan:
    """See SolverPlan; SuperLU orders each matrix anew."""

    def __init__(self, pattern: Pattern) -> None:
        self._pattern = pattern

    def factor(self, values: Array) -> SuperLUFactors:
        """See SolverPlan."""
        return SuperLUFactors(factorised(self._pattern.matrix(values)))


class SuperLUFactors:
    """See Factors; they stand for good."""

    def __init__(self, factors: Any) -> None:
        self._factors = factors

    @cached_property
    def positive(self) -> bool:
        """See Factors: all pivots are positive and stand on the diagonal."""
        factors = self._factors
        return bool((factors.U.diagonal() > 0.0).all()) and bool((factors.perm_r == factors.perm_c).all())

    def solve(self, right: Array) -> Array:
        """See Factors."""
        return np.asarray(self._factors.solve(right))

    def schur(self, rows: Rows) -> Array:
        """See Factors."""
        spread = spread_of(rows)
        product = spread.T @ self._factors.solve(spread)
        return np.asarray(0.5 * (product + product.T))


def factorised(matrix: sp.csc_matrix) -> Any:
    """SuperLU factors of a (nearly) symmetric matrix: diagonal pivots, minimum degree order of A + A^T.

    Raises:
        FactorisationError: the matrix is singular.
    """
    options = {"SymmetricMode": True}
    try:
        return splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    except RuntimeError as error:
        raise FactorisationError(f"the matrix has no factors: {error}") from error
