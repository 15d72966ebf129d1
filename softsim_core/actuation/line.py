"""The geometric stiffness of a straight line under tension, for actuators that pull along one."""

from __future__ import annotations

import numpy as np

from softsim_core.actuation.actuator import GeometricStiffness, no_geometric_stiffness
from softsim_core.arrays import Array, IndexArray
from softsim_core.mechanics.rows import Rows


def line_stiffness(nodes: IndexArray, weights: Array, line: Array, tension: float) -> GeometricStiffness:
    """That of a line between a point of a body and a point at rest: tension over length, across the line.

    Args:
        nodes: Nodes that carry the point, shape (k,).
        weights: Their weights, shape (k,).
        line: From one end to the other in [m], shape (3,).
        tension: In [N].
    """
    if tension == 0.0:
        return no_geometric_stiffness()
    length = float(np.linalg.norm(line))
    across = np.eye(3) - np.outer(line, line) / length**2  # three rows, of which the line itself makes two
    coefficient = (weights[None, :, None] * across[:, None, :]).reshape(-1, 3)
    rows = Rows(len(nodes) * np.arange(4), np.tile(nodes, 3), coefficient)
    return GeometricStiffness(rows, np.full(3, tension / length))
