"""What eliminating the nodes of a graph in some order costs: elimination tree and column counts.

A graph is given by `starts` (n + 1,) and `neighbours`: those of node i stand from starts[i] up to
starts[i + 1].

Source: Liu 1990, The role of elimination trees in sparse factorization.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from softsim_core.arrays import IndexArray
from softsim_core.linalg.compile import kernel


def graph_of(count: int, edges: IndexArray) -> tuple[IndexArray, IndexArray]:
    """The graph of `count` nodes with `edges` (e, 2), any order, repetitions and loops allowed."""
    pairs = edges[edges[:, 0] != edges[:, 1]]
    matrix = sp.coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count)).tocsr()
    whole = (matrix + matrix.T).tocsr()
    whole.sort_indices()
    return whole.indptr.astype(np.int64), whole.indices.astype(np.int64)


@kernel
def elimination_tree(starts: IndexArray, neighbours: IndexArray, order: IndexArray) -> IndexArray:
    """Parent of each position in the elimination tree, or -1; `order` (n,): nodes as they are eliminated."""
    count = len(order)
    position = np.empty(count, np.int64)
    for i in range(count):
        position[order[i]] = i
    parent, root = np.full(count, -1, np.int64), np.full(count, -1, np.int64)
    for j in range(count):
        for e in range(starts[order[j]], starts[order[j] + 1]):
            i = position[neighbours[e]]
            while i < j:
                above, root[i] = root[i], j
                if above == -1:
                    parent[i] = j
                    break
                i = above
    return parent


@kernel
def postordered(parent: IndexArray) -> IndexArray:
    """Positions such that children stand before their parents, and each subtree side by side, shape (n,)."""
    count = len(parent)
    first, following = np.full(count + 1, -1, np.int64), np.full(count, -1, np.int64)
    for i in range(count - 1, -1, -1):
        p = parent[i] if parent[i] >= 0 else count
        following[i], first[p] = first[p], i
    result, stack = np.empty(count, np.int64), np.empty(count + 1, np.int64)
    stack[0], height, done = count, 1, 0
    while height:
        node = stack[height - 1]
        child = first[node]
        if child >= 0:
            first[node], stack[height] = following[child], child
            height += 1
        else:
            height -= 1
            if node < count:
                result[done] = node
                done += 1
    return result


@kernel
def column_counts(
    starts: IndexArray, neighbours: IndexArray, order: IndexArray, parent: IndexArray
) -> IndexArray:
    """Entries below the diagonal of each column of the factor, by position, shape (n,)."""
    count = len(order)
    position, seen = np.empty(count, np.int64), np.full(count, -1, np.int64)
    for i in range(count):
        position[order[i]] = i
    counts = np.zeros(count, np.int64)
    for j in range(count):
        seen[j] = j
        for e in range(starts[order[j]], starts[order[j] + 1]):
            i = position[neighbours[e]]
            while i < j and seen[i] != j:
                seen[i] = j
                counts[i] += 1
                i = parent[i]
    return counts


def factor_cost(graph: tuple[IndexArray, IndexArray], order: IndexArray) -> tuple[float, float]:
    """What a Cholesky factor with 3 x 3 blocks takes in that order of nodes.

    Returns:
        Multiplications and additions, and the numbers that it has.
    """
    counts = column_counts(*graph, order, elimination_tree(*graph, order)) + 1.0
    return 27.0 * float((counts**2).sum()), 9.0 * float(counts.sum())
