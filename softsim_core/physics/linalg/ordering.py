"""Elimination orders for small factors: nested dissection, and the cost of an order.

A graph is given by `starts` (n + 1,) and `neighbours`: those of node i are at starts[i] up to starts[i + 1].

Source: Liu 1990, The role of elimination trees in sparse factorization.

Nodes that separate the graph into two halves are eliminated last, and each half is separated in the same way.
For the separation, distances along the graph to a few nodes far from one another serve as coordinates, the
median of the difference of two of them cuts, and moves of single nodes make the separator smaller. Small
parts are ordered by minimum degree among themselves, with the separators around them counted.

Sources: George 1973, Nested dissection of a regular finite element mesh; Fiduccia and Mattheyses 1982, and
Hendrickson and Rothberg 1998, Improving the run time and quality of nested dissection ordering.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from softsim_core.base import BoolArray, IndexArray
from softsim_core.physics.linalg.compile import kernel


def graph_of(count: int, edges: IndexArray) -> tuple[IndexArray, IndexArray]:
    """Return the graph of `count` nodes with `edges` (e, 2), any order, repetitions and loops allowed."""
    pairs = edges[edges[:, 0] != edges[:, 1]]
    matrix = sp.coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count)).tocsr()
    whole = (matrix + matrix.T).tocsr()
    whole.sort_indices()
    return whole.indptr.astype(np.int64), whole.indices.astype(np.int64)


@kernel
def elimination_tree(starts: IndexArray, neighbours: IndexArray, order: IndexArray) -> IndexArray:
    """Return the parent of each position in the elimination tree, or -1.

    `order` (n,) lists the nodes in the order of elimination.
    """
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
def postorder(parent: IndexArray) -> IndexArray:
    """Return positions with children before their parents and each subtree contiguous, shape (n,)."""
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
    """Return the entries below the diagonal of each column of the factor, by position, shape (n,)."""
    count = len(order)
    position, visited = np.empty(count, np.int64), np.full(count, -1, np.int64)
    for i in range(count):
        position[order[i]] = i
    counts = np.zeros(count, np.int64)
    for j in range(count):
        visited[j] = j
        for e in range(starts[order[j]], starts[order[j] + 1]):
            i = position[neighbours[e]]
            while i < j and visited[i] != j:
                visited[i] = j
                counts[i] += 1
                i = parent[i]
    return counts


def factor_cost(graph: tuple[IndexArray, IndexArray], order: IndexArray) -> tuple[float, float]:
    """Return the cost of a Cholesky factor with 3 x 3 blocks in that order of nodes.

    Returns:
        Its multiplications and additions, and its numbers.
    """
    counts = column_counts(*graph, order, elimination_tree(*graph, order)) + 1.0
    return 27.0 * float((counts**2).sum()), 9.0 * float(counts.sum())


LEAF = 96
"""Largest number of nodes in a part that is ordered by minimum degree."""

LANDMARKS = 5
"""Number of nodes to which distances are measured."""

UNBALANCED = 0.62
"""Largest share of the nodes beside the separator in the larger half."""

IMPROVED = 3
"""Number of cuts between landmarks that are improved: those with the smallest separators."""

PATIENCE = 60
"""Moves without a smaller separator after which a pass ends; larger separators have more."""

PASSES = 6
"""Largest number of passes of moves; a pass that does not help is the last."""

SEPARATOR, OUTSIDE = 2, 3
"""Sides of nodes besides 0 and 1."""


@kernel
def distances(
    starts: IndexArray, neighbours: IndexArray, inside: BoolArray, first: int, distance: IndexArray,
    queue: IndexArray,
) -> int:  # fmt: skip
    """Compute the steps along the graph from `first` to the nodes inside.

    List these in `queue`, nearest first.

    Returns:
        The number of nodes reached.
    """
    distance[first], queue[0], done, size = 0, first, 0, 1
    while done < size:
        node = queue[done]
        done += 1
        for e in range(starts[node], starts[node + 1]):
            other = neighbours[e]
            if inside[other] and distance[other] < 0:
                distance[other] = distance[node] + 1
                queue[size] = other
                size += 1
    return size


@kernel
def landmark_distances(
    starts: IndexArray, neighbours: IndexArray, nodes: IndexArray, inside: BoolArray, queue: IndexArray
) -> IndexArray:
    """Return the distances of all nodes from nodes that are far from one another, shape (LANDMARKS, n).

    The first row is -1 for `nodes` that cannot be reached from the others.
    """
    result = np.full((LANDMARKS, len(inside)), -1, np.int64)
    size = distances(starts, neighbours, inside, nodes[0], result[0], queue)
    first = queue[size - 1]
    for node in nodes:
        result[0, node] = -1
    size = distances(starts, neighbours, inside, first, result[0], queue)
    if size < len(nodes):
        return result
    nearest = result[0].copy()
    for k in range(1, LANDMARKS):
        far = nodes[0]
        for node in nodes:
            if nearest[node] > nearest[far]:
                far = node
        distances(starts, neighbours, inside, far, result[k], queue)
        for node in nodes:
            nearest[node] = min(nearest[node], result[k, node])
    return result


@kernel
def sort_by(measure: IndexArray, nodes: IndexArray, result: IndexArray) -> None:
    """Sort the nodes by ascending `measure` (of each of them), stably."""
    low, high = measure.min(), measure.max()
    ends = np.zeros(high - low + 2, np.int64)
    for value in measure:
        ends[value - low + 1] += 1
    for i in range(1, len(ends)):
        ends[i] += ends[i - 1]
    for i in range(len(nodes)):
        result[ends[measure[i] - low]] = nodes[i]
        ends[measure[i] - low] += 1


@kernel
def cut(starts: IndexArray, neighbours: IndexArray, order: IndexArray, side: IndexArray) -> int:
    """Cut nodes in that order at the middle into two sides and a separator; return the separator's size."""
    half, size = len(order) // 2, 0
    for i in range(len(order)):
        side[order[i]] = 0 if i < half else 1
    for node in order[half:]:
        for e in range(starts[node], starts[node + 1]):
            if side[neighbours[e]] == 0:
                side[node] = SEPARATOR
                size += 1
                break
    return size


@kernel
def change_side(
    starts: IndexArray, neighbours: IndexArray, node: int, to: int, side: IndexArray, sizes: IndexArray,
    beside: IndexArray,
) -> None:  # fmt: skip
    """Move a node to a side, or into the separator; `beside` (n, 3) counts each node's neighbours there."""
    before = side[node]
    sizes[before] -= 1
    sizes[to] += 1
    side[node] = to
    for e in range(starts[node], starts[node + 1]):
        beside[neighbours[e], before] -= 1
        beside[neighbours[e], to] += 1


@kernel
def best_move(
    separator: IndexArray, beside: IndexArray, sizes: IndexArray, moved: BoolArray, largest: float
) -> tuple[int, int]:
    """Return the separator node, and side, of the move that makes the separator smallest.

    -1: none may move.
    """
    best, found, to = 1 << 40, -1, 0
    for goal in range(2):
        fits, uneven = sizes[goal] + 1 <= largest, 1 if sizes[goal] > sizes[1 - goal] else 0
        for i in range(sizes[SEPARATOR]):
            coming = beside[separator[i], 1 - goal]
            cost = 2 * coming + uneven
            if cost < best and not moved[separator[i]] and (fits or sizes[goal] < sizes[1 - goal] - coming):
                best, found, to = cost, i, goal
    return found, to


@kernel
def improve(
    starts: IndexArray, neighbours: IndexArray, nodes: IndexArray, side: IndexArray, beside: IndexArray,
    moved: BoolArray,
) -> int:  # fmt: skip
    """Make the separator among `nodes` smaller by moves of single nodes; return its size."""
    separator, sizes = np.empty(len(nodes), np.int64), np.zeros(4, np.int64)
    for node in nodes:
        sizes[side[node]] += 1
        beside[node] = 0
        for e in range(starts[node], starts[node + 1]):
            beside[node, side[neighbours[e]]] += 1
    largest = UNBALANCED * len(nodes)
    log = np.empty((8 * len(nodes), 2), np.int64)
    for _ in range(PASSES):
        smallest, even, best_logged, logged, since, height = (
            sizes[SEPARATOR],
            max(sizes[0], sizes[1]),
            0,
            0,
            0,
            0,
        )
        before = smallest
        for node in nodes:
            moved[node] = False
            if side[node] == SEPARATOR:
                separator[height] = node
                height += 1
        while since < PATIENCE + sizes[SEPARATOR] // 8 and logged + len(nodes) < len(log):
            place, to = best_move(separator, beside, sizes, moved, largest)
            if place < 0:
                break
            node = separator[place]
            separator[place] = separator[sizes[SEPARATOR] - 1]
            moved[node] = True
            change_side(starts, neighbours, node, to, side, sizes, beside)
            log[logged, 0], log[logged, 1] = node, SEPARATOR
            logged += 1
            for e in range(starts[node], starts[node + 1]):
                other = neighbours[e]
                if side[other] == 1 - to:
                    separator[sizes[SEPARATOR]] = other
                    change_side(starts, neighbours, other, SEPARATOR, side, sizes, beside)
                    log[logged, 0], log[logged, 1] = other, 1 - to
                    logged += 1
            since += 1
            larger = max(sizes[0], sizes[1])
            if sizes[SEPARATOR] < smallest or (sizes[SEPARATOR] == smallest and larger < even):
                smallest, best_logged, even, since = sizes[SEPARATOR], logged, larger, 0
        for i in range(logged - 1, best_logged - 1, -1):
            change_side(starts, neighbours, log[i, 0], log[i, 1], side, sizes, beside)
        if smallest == before:
            break
    return int(sizes[SEPARATOR])


@kernel
def part_in_two(
    starts: IndexArray, neighbours: IndexArray, nodes: IndexArray, far: IndexArray, side: IndexArray,
    beside: IndexArray, moved: BoolArray,
) -> None:  # fmt: skip
    """Find the sides of `nodes` by the smallest separator of the cuts between two landmarks.

    The best cuts are improved first.
    """
    pairs, measure = LANDMARKS * (LANDMARKS - 1) // 2, np.empty(len(nodes), np.int64)
    orders, size = np.empty((pairs, len(nodes)), np.int64), np.empty(pairs, np.int64)
    k = 0
    for a in range(LANDMARKS):
        for b in range(a):
            for i in range(len(nodes)):
                measure[i] = far[a, nodes[i]] - far[b, nodes[i]]
            sort_by(measure, nodes, orders[k])
            size[k] = cut(starts, neighbours, orders[k], side)
            k += 1
    smallest, best = len(nodes) + 1, np.empty(len(nodes), np.int64)
    candidates = np.empty(pairs, np.int64)
    sort_by(size, np.arange(pairs), candidates)
    for k in candidates[:IMPROVED]:
        cut(starts, neighbours, orders[k], side)
        found = improve(starts, neighbours, nodes, side, beside, moved)
        if found < smallest:
            smallest = found
            for i in range(len(nodes)):
                best[i] = side[nodes[i]]
    for i in range(len(nodes)):
        side[nodes[i]] = best[i]


@kernel
def minimum_degree_inside(
    starts: IndexArray, neighbours: IndexArray, nodes: IndexArray, place: IndexArray, result: IndexArray
) -> None:
    """Write an order of a few `nodes` into `result`, each time the node with the fewest neighbours.

    The remaining neighbours of an eliminated node become neighbours of one another. `place` is -1 for all
    nodes of the graph, before and after.
    """
    own, size = len(nodes), len(nodes)
    halo = np.empty(sum([starts[node + 1] - starts[node] for node in nodes]), np.int64)
    for i in range(own):
        place[nodes[i]] = i
    for node in nodes:
        for e in range(starts[node], starts[node + 1]):
            if place[neighbours[e]] < 0:
                place[neighbours[e]] = size
                halo[size - own] = neighbours[e]
                size += 1
    joined = np.zeros((own, size), np.bool_)
    degree = np.zeros(own, np.int64)
    for i in range(own):
        for e in range(starts[nodes[i]], starts[nodes[i] + 1]):
            joined[i, place[neighbours[e]]] = True
        degree[i] = starts[nodes[i] + 1] - starts[nodes[i]]
    for node in nodes:
        place[node] = -1
    for i in range(size - own):
        place[halo[i]] = -1
    done, around = np.zeros(own, np.bool_), np.empty(size, np.int64)
    for step in range(own):
        chosen = -1
        for i in range(own):
            if not done[i] and (chosen < 0 or degree[i] < degree[chosen]):
                chosen = i
        result[step], done[chosen], count = nodes[chosen], True, 0
        for j in range(size):
            if joined[chosen, j] and (j >= own or not done[j]):
                around[count] = j
                count += 1
        for a in range(count):
            i = around[a]
            if i >= own:
                continue
            for b in range(count):
                joined[i, around[b]] = True
            joined[i, i] = joined[i, chosen] = False
            degree[i] = 0
            for j in range(size):
                degree[i] += joined[i, j]


@kernel
def nested_dissection(starts: IndexArray, neighbours: IndexArray) -> IndexArray:
    """Return the nodes of a graph in the order of their elimination, shape (n,)."""
    count = len(starts) - 1
    result, nodes = np.empty(count, np.int64), np.arange(count)
    inside, moved, queue = np.zeros(count, np.bool_), np.zeros(count, np.bool_), np.empty(count, np.int64)
    side, place = np.full(count, OUTSIDE, np.int64), np.full(count, -1, np.int64)
    beside = np.zeros((count, 4), np.int64)
    stack = [(0, count)]
    while len(stack):
        low, high = stack.pop()
        part = nodes[low:high].copy()
        if high - low <= LEAF:
            if high > low:
                minimum_degree_inside(starts, neighbours, part, place, result[low:high])
            continue
        for node in part:
            inside[node] = True
        far = landmark_distances(starts, neighbours, part, inside, queue)
        for node in part:
            inside[node] = False
        apart = False
        for node in part:
            side[node] = 0 if far[0, node] >= 0 else 1
            apart = apart or far[0, node] < 0
        if not apart:
            part_in_two(starts, neighbours, part, far, side, beside, moved)
        ends = np.zeros(4, np.int64)
        for node in part:
            ends[side[node] + 1] += 1
        if max(ends[1], ends[2]) == 0 or max(ends[1], ends[2]) == high - low:  # complete graph
            for i in range(low, high):
                result[i] = nodes[i]
        else:
            ends[2] += ends[1]
            stack.append((low, low + ends[1]))
            stack.append((low + ends[1], low + ends[2]))
            ends[3] += ends[2]
            for node in part:
                nodes[low + ends[side[node]]] = node
                ends[side[node]] += 1
            for i in range(low + ends[1], high):
                result[i] = nodes[i]
        for node in part:
            side[node] = OUTSIDE
    return result


LARGE = 4000
"""Number of nodes above which minimum degree is not tried, because it takes longer than it gains."""


def elimination_order(graph: tuple[IndexArray, IndexArray]) -> IndexArray:
    """Return the nodes of a graph in the better order of minimum degree and nested dissection."""
    dissected = nested_dissection(*graph)
    if not 0 < len(dissected) <= LARGE:
        return dissected
    greedy = minimum_degree(graph)
    return greedy if factor_cost(graph, greedy)[0] <= factor_cost(graph, dissected)[0] else dissected


def minimum_degree(graph: tuple[IndexArray, IndexArray]) -> IndexArray:
    """Return the nodes of a graph in the order of SuperLU's multiple minimum degree."""
    starts, neighbours = graph
    count = len(starts) - 1
    pattern = sp.csr_matrix((np.full(len(neighbours), -1.0), neighbours, starts), shape=(count, count))
    dominant = (pattern + sp.diags(np.diff(starts) + 1.0)).tocsc()
    options = {"SymmetricMode": True}
    factors = splu(dominant, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    return np.argsort(factors.perm_c).astype(np.int64)
