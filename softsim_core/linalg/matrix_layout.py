"""Where the numbers of a symmetric matrix stand that is not factored: its own entries in panels, no fill.

The layout is a `symbolic.Plan` in which each node stands alone, so that all that writes into the panels of a
factor writes into these as well.
"""

from __future__ import annotations

import numpy as np

from softsim_core.arrays import IndexArray, unique_pairs
from softsim_core.linalg.symbolic import Plan, padded

BLOCK = 3
"""Unknowns of a node."""


def matrix_layout(
    position: IndexArray, edges: IndexArray, border_edges: IndexArray, border_size: int, lanes: int
) -> Plan:
    """The layout of a matrix: panel rows [own block | coupled later nodes | border | right-hand side].

    Args:
        position: Place of each free node in the order of unknowns, shape (f,).
        edges: Pairs of coupled free nodes, shape (e, 2), any order, repetitions allowed.
        border_edges: Pairs (free node, border unknown), shape (g, 2).
        border_size: Number of border unknowns.
        lanes: Rows are padded to a multiple of it.
    """
    count = len(position)
    placed = position[edges]
    upper = unique_pairs(np.sort(placed[placed[:, 0] != placed[:, 1]], axis=1))
    beside = unique_pairs(border_edges)
    owner = np.concatenate([np.repeat(upper[:, 0], BLOCK), position[beside[:, 0]]])
    blocks = BLOCK * upper[:, 1, None] + np.arange(BLOCK)
    unknown = np.concatenate([blocks.ravel(), BLOCK * count + beside[:, 1]])
    order = np.lexsort((unknown, owner))
    coupled = np.bincount(owner, minlength=count)
    columns, later, side = np.full(count, BLOCK), np.full(count, padded(BLOCK, lanes)), coupled + 1
    width = later + padded(side, lanes)
    panel = np.concatenate([[0], np.cumsum(BLOCK * width)])
    none = np.zeros(0, dtype=np.int64)
    return Plan(
        position=position,
        columns=columns,
        first_column=BLOCK * np.arange(count),
        parent=np.full(count, -1),
        later=later,
        side=side,
        width=width,
        panel=panel,
        update=np.zeros(count, dtype=np.int64),
        stack_size=0,
        first_child=np.zeros(count + 2, dtype=np.int64),
        children=none,
        first_run=np.zeros(count + 1, dtype=np.int64),
        runs=np.zeros((0, 3), dtype=np.int64),
        first_row=np.concatenate([[0], np.cumsum(coupled)]),
        row_index=unknown[order],
        supernode=position,
        row_offset=panel[position],
    )
