"""Nodes inside a box or a sphere, chosen on rest positions."""

from __future__ import annotations

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.mechanics.pose import rotation_euler
from softsim_core.values import Box, Sphere

SLACK_M = 1e-9
"""Faces are included; this much rounding is forgiven, in [m]."""


def nodes_in(region: Box | Sphere, points: Array) -> IndexArray:
    """Indices of the `points` (n, 3), in the region's coordinates, that lie inside it, ascending."""
    offset = points - np.array(region.center)
    if isinstance(region, Sphere):
        return np.flatnonzero(np.linalg.norm(offset, axis=1) <= region.radius + SLACK_M)
    local = offset @ rotation_euler(np.radians(region.rotation_deg))
    return np.flatnonzero((np.abs(local) <= np.array(region.size) / 2 + SLACK_M).all(axis=1))
