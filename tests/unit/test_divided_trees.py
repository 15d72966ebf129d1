"""Threads that share a factorisation or an iteration: right, and the same bits for any number of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("numba")
pytestmark = pytest.mark.numba

from softsim_core import box_mesh  # noqa: E402
from softsim_core.physics.dynamics.numba_backend import node_pairs  # noqa: E402
from softsim_core.physics.linalg import (  # noqa: E402  # noqa: E402  # noqa: E402
    LANES,
    LARGE,
    ROWS,
    Matrix,
    Plan,
    Preconditioner,
    Teamwork,
    allocate_panels,
    conjugate,
    conjugate_gradients,
    copy_matrix,
    divide_tree,
    empty_factor,
    factor,
    lead_factor,
    matrix_layout,
    matrix_of,
    open_agenda,
    plan,
    plan_stack,
    precondition,
    round_up,
    sharing_of,
    support_factor,
    support_gradients,
    tree_of,
    with_space_for,
)

CELLS = (9, 8, 8)


def matrix_on_a_box(cells: tuple[int, int, int] = CELLS) -> tuple[Plan, Matrix]:
    """A positive matrix that couples the nodes of a box, whose separators are large panels."""
    mesh = box_mesh((0.1, 0.1, 0.1), cells)
    count, edges = len(mesh.points), np.unique(node_pairs(mesh.tets), axis=0)
    layout = plan(count, edges, edges[:0], 0, LANES, ROWS)
    own = matrix_layout(layout.position, edges, edges[:0], 0, LANES)
    matrix = matrix_of(np.zeros(own.panel[-1]), own)
    rng = np.random.default_rng(0)
    for i in range(count):
        for k in range(3):
            row = matrix.row[i] + k * matrix.width[i]
            first = row + matrix.later[i]
            number = 3 * int(matrix.start[i + 1] - matrix.start[i])
            matrix.panels[first : first + number] = rng.uniform(-1.0, 1.0, size=number)
            matrix.panels[row + k] = 60.0
    return layout, matrix


def supernodes(layout: Plan) -> Any:
    """Of each node, by unknown."""
    return layout.supernode[np.argsort(layout.position)]


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_a_divided_factor_is_the_whole_one_and_the_same_for_any_threads(kind: type) -> None:
    layout, matrix = matrix_on_a_box()
    division = divide_tree(layout, 0.0)
    sizes = np.diff(layout.panel)[division.above]
    assert len(division.first) > 4
    assert sizes.max() > LARGE  # panels that are factored in pieces
    results = []
    for threads in (0, 1, 2, 3):
        chosen = with_space_for(layout, division, ROWS) if threads else layout
        tree, store = tree_of(chosen), empty_factor(chosen, 0, kind)
        copy_matrix(matrix, tree, supernodes(layout), store.panels)
        if threads:
            team = Teamwork(threads, lead_factor, support_factor)
            team(tree, store, division, allocate_panels(tree, division, kind))
        else:
            factor(tree, store)
        results.append(store.panels)
    whole, *parts = results
    assert np.abs(parts[0] - whole).max() < 30.0 * np.finfo(kind).eps * np.abs(whole).max()
    assert all(np.array_equal(parts[0], each) for each in parts[1:])


def test_divided_gradients_find_the_solution_and_the_same_for_any_threads() -> None:
    layout, matrix = matrix_on_a_box()
    division = divide_tree(layout, 0.0)
    tree, store = tree_of(layout), empty_factor(layout, 0, np.float32)
    copy_matrix(matrix, tree, supernodes(layout), store.panels)
    factor(tree, store)
    count = len(layout.position)
    b, results = np.random.default_rng(1).normal(size=3 * count), []
    for parts in (division, division, division, divide_tree(layout, np.inf)):
        rotations, line = np.broadcast_to(np.eye(3), (count, 3, 3)).copy(), int(layout.width.max()) + ROWS
        rotations[:, :2, :2] = np.array([[0.8, -0.6], [0.6, 0.8]])  # a poor preconditioner: many iterations
        by = Preconditioner(
            tree, store.panels, rotations, np.zeros(3 * count, np.float32), np.zeros(line, np.float32)
        )
        x, sharing = np.zeros(3 * count), sharing_of(parts, 3 * count)
        team = Teamwork(1 + len(results) % 3, conjugate_gradients, support_gradients)
        for _ in range(2):  # nothing is left of one solution in the next
            assert team(matrix, by, sharing, b, x, 1e-13, 0.0, 150) > 3
        results.append(x)
    assert np.array_equal(results[0], results[1])
    assert np.array_equal(results[0], results[2])
    assert np.abs(results[0] - results[3]).max() < 1e-12
    whole = dense(matrix)
    assert np.abs(whole @ results[0] - b).max() < 1e-10


@pytest.mark.slow
def test_parts_and_pieces_precondition_as_the_whole_tree_does() -> None:
    layout, matrix = matrix_on_a_box((16, 12, 12))
    division, count = divide_tree(layout, 0.0), len(layout.position)
    large = division.above[np.diff(layout.panel)[division.above] > LARGE]
    assert (
        (layout.columns[large] % conjugate.BLOCK > 0) & (layout.side[large] > 1)
    ).any()  # a last block is not full
    tree, store = tree_of(layout), empty_factor(layout, 0, np.float32)
    copy_matrix(matrix, tree, supernodes(layout), store.panels)
    factor(tree, store)
    rotations, room = np.broadcast_to(np.eye(3), (count, 3, 3)).copy(), np.zeros(3 * count, np.float32)
    line = np.zeros(int(layout.width.max()) + ROWS, np.float32)
    by, results = Preconditioner(tree, store.panels, rotations, room, line), []
    for parts in (division, divide_tree(layout, np.inf)):
        sharing = sharing_of(parts, 3 * count)
        sharing.work[0] = np.random.default_rng(2).normal(size=3 * count)
        precondition(matrix, by, sharing, 1.0, open_agenda())
        results.append(sharing.work[1])
    assert np.abs(results[0] - results[1]).max() < 1e-5 * np.abs(results[1]).max()


@pytest.mark.parametrize("seed", range(20))
def test_updates_that_wait_at_the_same_time_lie_apart(seed: int) -> None:
    rng = np.random.default_rng(seed)
    size, first = int(rng.integers(2, 60)), int(rng.integers(0, 20))
    parent = np.array([rng.integers(s + 1, size) if s < size - 1 else -1 for s in range(size)])
    parent[rng.random(size) < 0.1] = -1
    needs, update = 8 * rng.integers(0, 40, size), np.zeros(size, np.int64)
    first = min(first, size - 1)
    end = plan_stack(np.arange(first), needs, parent, update, 16)
    waiting = np.flatnonzero((np.arange(size) < first) & ((parent >= first) | (parent < 0)))
    end = max(end, plan_stack(np.arange(first, size), needs, parent, update, 16, waiting))
    until = np.where(parent < 0, size, parent)
    for s in range(size):
        for t in range(s):
            if s <= until[t]:  # t is still needed when s begins
                assert update[t] + needs[t] <= update[s] or update[s] + needs[s] <= update[t]
    assert update.min() >= 16
    assert (update + needs).max() == end


def test_updates_of_several_bodies_lie_apart_until_the_last_unknowns_have_taken_them() -> None:
    """Three boxes on one frame: trees of their own, whose roots leave what the frame takes at the end."""
    bodies, count = [], 0
    for cells in ((3, 3, 3), (8, 7, 7), (4, 3, 3)):
        mesh = box_mesh((0.1, 0.1, 0.1), cells)
        bodies.append(count + np.unique(node_pairs(mesh.tets), axis=0))
        count += len(mesh.points)
    frame = np.stack(np.meshgrid(np.arange(count, step=5), np.arange(6)), axis=-1).reshape(-1, 2)
    layout = plan(count, np.concatenate(bodies), frame, 6, LANES, ROWS)
    division = divide_tree(layout, 0.0)
    roomy = with_space_for(layout, division, ROWS)
    part = np.full(len(layout.parent), -1)
    for number, (low, high) in enumerate(zip(division.first, division.end, strict=True)):
        part[low:high] = number
    roots = (layout.parent < 0) & (layout.side > 1)
    assert len(division.above) > 0
    assert (roots & (part >= 0)).any()  # a small body lies in a part as a whole
    length = round_up(layout.side, ROWS) * (layout.width - layout.later)
    until = np.where(layout.parent < 0, len(layout.parent), layout.parent)
    for s in np.flatnonzero(length):
        for t in np.flatnonzero(length[:s]):
            other_part = part[s] >= 0 and part[t] >= 0 and part[s] != part[t]  # at the same time, maybe
            if other_part or (part[s] in (-1, part[t]) and s <= until[t]):
                before, after = sorted((s, t), key=lambda each: roomy.update[each])
                assert roomy.update[before] + length[before] <= roomy.update[after]
    assert (roomy.update + length).max() <= roomy.stack_size


def dense(matrix: Matrix) -> np.ndarray:
    """The matrix, whole."""
    count = len(matrix.row)
    result = np.zeros((3 * count, 3 * count))
    for i in range(count):
        nodes = [i, *matrix.node[matrix.start[i] : matrix.start[i + 1]].tolist()]
        columns = [0, *(matrix.later[i] + 3 * np.arange(len(nodes) - 1)).tolist()]
        for j, column in zip(nodes, columns, strict=True):
            for k in range(3):
                at = matrix.row[i] + k * matrix.width[i] + column
                result[3 * i + k, 3 * j : 3 * j + 3] = matrix.panels[at : at + 3]
    return np.asarray(np.triu(result) + np.triu(result, 1).T)
