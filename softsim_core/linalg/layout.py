"""The arrays that the compiled factorisation works on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.linalg.symbolic import Plan


class Tree(NamedTuple):
    """The plan of symbolic.Plan; first scalar unknown of each supernode, and the one above it or -1, (s,)."""

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

    panels: Array
    stack: Array
    schur: Array
    solution: Array
    gathered: Array


def tree_of(plan: Plan) -> Tree:
    """The arrays of a plan for the kernels."""
    arrays = {name: getattr(plan, name) for name in Tree._fields[:-2]}
    first_column = np.concatenate([np.zeros(1, np.int64), np.cumsum(plan.columns)])[: len(plan.columns)]
    parent = np.full(len(plan.columns), -1, dtype=np.int64)
    for s in range(len(parent)):
        parent[plan.children[plan.first_child[s] : plan.first_child[s + 1]]] = s
    return Tree(**arrays, first_column=first_column, parent=parent)


def empty_factor(plan: Plan, dense: int) -> Factor:
    """Room for a matrix with that plan and so many dense unknowns."""
    return Factor(
        panels=np.zeros(plan.panel[-1]),
        stack=np.zeros(plan.stack_size),
        schur=np.zeros((dense, dense + 1)),
        solution=np.zeros(3 * len(plan.position) + dense),
        gathered=np.zeros(int(plan.width.max(initial=1))),
    )
