"""SciPy's SuperLU: sparse LU factors with diagonal pivots, for matrices that need not be positive."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from softsim_core.arrays import Array
from softsim_core.errors import FactorisationError
from softsim_core.linalg.linear_solver import Pattern, Rows, spread_of


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
