"""Compiled count of the elements that are inside out: a few microseconds a thousand elements."""

from __future__ import annotations

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.dynamics.numba_backend.compile import kernel
from softsim_core.mechanics.model import Model


@kernel
def count_inverted(x: Array, corners: IndexArray) -> int:
    """How many tetrahedra `corners` (m, 4), all of positive volume at rest, have det F <= 0 at x (n, 3)."""
    count = 0
    for e in range(len(corners)):
        o, a, b, c = corners[e, 0], corners[e, 1], corners[e, 2], corners[e, 3]
        a0, a1, a2 = x[a, 0] - x[o, 0], x[a, 1] - x[o, 1], x[a, 2] - x[o, 2]
        b0, b1, b2 = x[b, 0] - x[o, 0], x[b, 1] - x[o, 1], x[b, 2] - x[o, 2]
        c0, c1, c2 = x[c, 0] - x[o, 0], x[c, 1] - x[o, 1], x[c, 2] - x[o, 2]
        volume = a0 * (b1 * c2 - b2 * c1) + a1 * (b2 * c0 - b0 * c2) + a2 * (b0 * c1 - b1 * c0)
        count += 1 if volume <= 0.0 else 0
    return count


def oriented(model: Model) -> IndexArray:
    """Corners of all cells of four nodes in an order of positive volume at rest, shape (m, 4)."""
    linear = [group.cells for group in model.filling if group.cells.shape[1] == 4]
    corners = np.concatenate([np.zeros((0, 4), np.int64), *linear])
    points = model.rest[corners]
    mirrored = np.linalg.det(points[:, 1:] - points[:, :1]) < 0.0
    corners[mirrored] = corners[mirrored][:, [1, 0, 2, 3]]
    return corners
