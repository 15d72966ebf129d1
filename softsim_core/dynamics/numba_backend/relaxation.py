"""Compiled memory of cells of a relaxing law; the formulas are those of fem.prony."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softsim_core.arrays import Array
from softsim_core.dynamics.numba_backend.compile import kernel
from softsim_core.dynamics.numba_backend.point_cells import PointCells
from softsim_core.dynamics.numba_backend.point_lanes import POINT_ROWS
from softsim_core.fem.prony import FLATTEST
from softsim_core.linalg.simd import LANES

LEAST_VOLUME = FLATTEST


class Memory(NamedTuple):
    """What m cells with q points remember of t terms, see fem.prony.memory_shape, and how it fades in a step.

    Attributes:
        stresses: s of each term and then S in [Pa], shape (m, q, t + 1, 3, 3).
        fades: exp(-h / tau), shape (m, t).
        gains: g exp(-h / 2 tau), shape (m, t).
    """

    stresses: Array
    fades: Array
    gains: Array


@kernel
def hold(memory: Memory, held: Array) -> None:
    """H of a step into `held` (m, q, 3, 3)."""
    stresses, fades, gains = memory.stresses, memory.fades, memory.gains
    terms = fades.shape[1]
    for e in range(len(stresses)):
        gain = 0.0
        for t in range(terms):
            gain += gains[e, t]
        for q in range(stresses.shape[1]):
            for i in range(3):
                for j in range(3):
                    total = -gain * stresses[e, q, terms, i, j]
                    for t in range(terms):
                        total += fades[e, t] * stresses[e, q, t, i, j]
                    held[e, q, i, j] = total


@kernel
def remember(batch: int, cells: PointCells, memory: Memory) -> None:
    """Take over S of a batch, from the stress of its points without any pressure."""
    points, weights, size = cells.room.points, cells.weights, cells.cells.size[0]
    stresses, fades, gains = memory.stresses, memory.fades, memory.gains
    count, terms = len(weights) // len(cells.cells.nodes), fades.shape[1]
    f, p, inverse, s = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for lane in range(min(LANES, size - batch * LANES)):
        e = cells.memory[batch * LANES + lane]
        for q in range(count):
            row, over = POINT_ROWS * q, 1.0 / weights[count * batch + q, lane]
            for i in range(3):
                for j in range(3):
                    f[i, j] = points[row + 3 * i + j, lane]
                    p[i, j] = over * points[row + 30 + 3 * i + j, lane]
            for i in range(3):
                a, b = (i + 1) % 3, (i + 2) % 3
                for j in range(3):
                    c, d = (j + 1) % 3, (j + 2) % 3
                    inverse[j, i] = f[a, c] * f[b, d] - f[a, d] * f[b, c]
            volume = f[0, 0] * inverse[0, 0] + f[0, 1] * inverse[1, 0] + f[0, 2] * inverse[2, 0]
            if volume > LEAST_VOLUME:
                for i in range(3):
                    for j in range(3):
                        s[i, j] = 0.0
                        for k in range(3):
                            s[i, j] += inverse[i, k] * p[k, j]
                        s[i, j] /= volume
            else:
                s[:] = stresses[e, q, terms]
            for i in range(3):
                for j in range(3):
                    now = 0.5 * (s[i, j] + s[j, i])
                    gained = now - stresses[e, q, terms, i, j]
                    for t in range(terms):
                        past = fades[e, t] * stresses[e, q, t, i, j]
                        stresses[e, q, t, i, j] = past + gains[e, t] * gained
                    stresses[e, q, terms, i, j] = now
