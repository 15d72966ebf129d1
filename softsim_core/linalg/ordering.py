"""Elimination orders: the better one for a graph, by the work that it makes."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from softsim_core.arrays import IndexArray
from softsim_core.linalg.dissection import nested_dissection
from softsim_core.linalg.elimination import factor_cost

LARGE = 4000
"""Graphs of more nodes are dissected without a look at minimum degree, which takes longer than it gains."""


def elimination_order(graph: tuple[IndexArray, IndexArray]) -> IndexArray:
    """Nodes of a graph (see elimination) as they are best eliminated: minimum degree or nested dissection."""
    dissected = nested_dissection(*graph)
    if not 0 < len(dissected) <= LARGE:
        return dissected
    greedy = minimum_degree(graph)
    return greedy if factor_cost(graph, greedy)[0] <= factor_cost(graph, dissected)[0] else dissected


def minimum_degree(graph: tuple[IndexArray, IndexArray]) -> IndexArray:
    """Nodes of a graph in the order of SuperLU's multiple minimum degree."""
    starts, neighbours = graph
    count = len(starts) - 1
    pattern = sp.csr_matrix((np.full(len(neighbours), -1.0), neighbours, starts), shape=(count, count))
    dominant = (pattern + sp.diags(np.diff(starts) + 1.0)).tocsc()
    options = {"SymmetricMode": True}
    factors = splu(dominant, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    return np.argsort(factors.perm_c).astype(np.int64)
