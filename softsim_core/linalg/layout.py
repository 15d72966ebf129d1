"""The arrays that the compiled factorisation works on."""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from softsim_core.arrays import IndexArray
from softsim_core.linalg.symbolic import Plan

Numbers: TypeAlias = NDArray[Any]
"""float64 or float32 array; all arrays of a Factor that kernels get are of one type."""


class Tree(NamedTuple):
    """See symbolic.Plan."""

    columns: IndexArray
    later: IndexArray
    side: IndexArray
    width: IndexArray
    panel: IndexArray
    update: IndexArray
    first_child: IndexArray
    children: IndexArray
    first_run: IndexArray
    runs: IndexArray
    first_row: IndexArray
    row_index: IndexArray
    first_column: IndexArray
    parent: IndexArray


class Factor(NamedTuple):
    """A matrix with its right-hand side on its way to a Cholesky factor and a solution.

    Attributes:
        panels, stack: Factor panels, and update matrices not yet used.
        schur: Upper triangle of the matrix of the dense unknowns, then the right-hand side, (d, d + 1).
        solution: All scalar unknowns, the sparse ones first, shape (3 f + d,).
        gathered: One panel row's unknowns.
    """

    panels: Numbers
    stack: Numbers
    schur: Numbers
    solution: Numbers
    gathered: Numbers


def tree_of(plan: Plan) -> Tree:
    """The arrays of a plan for the kernels."""
    return Tree(**{name: getattr(plan, name) for name in Tree._fields})


def empty_factor(plan: Plan, dense: int, kind: type[np.floating[Any]] = np.float64) -> Factor:
    """Room for a matrix with that plan and so many dense unknowns, in numbers of one type."""
    return Factor(
        panels=np.zeros(plan.panel[-1], kind),
        stack=np.zeros(plan.stack_size, kind),
        schur=np.zeros((dense, dense + 1), kind),
        solution=np.zeros(3 * len(plan.position) + dense, kind),
        gathered=np.zeros(int(plan.width.max(initial=1)), kind),
    )


def clear(factor: Factor) -> None:
    """Make the matrix and its right-hand side zero."""
    factor.panels.fill(0.0)
    factor.schur.fill(0.0)
