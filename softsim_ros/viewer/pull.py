"""Pulling on the body with the mouse: a spring from a vertex to the cursor, sent as a force while held."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from softsim_ros.viewer.surface import MM

REPEAT_PERIOD_S = 0.05
"""The force is sent this often in [s]; the simulator lets go half a second after the last one."""


@dataclass
class Pull:
    """A pull in progress.

    Attributes:
        vertex: Index of the pulled vertex of the visible surface.
        offset: From that vertex to where the mouse took hold, in [mm], shape (3,).
        target: Where the cursor is, in [mm], shape (3,).
        sent_at: Time of the last message in [s].
    """

    vertex: int
    offset: NDArray[np.float64]
    target: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    sent_at: float = -1.0

    def force(self, points: NDArray[np.float32], stiffness: float, limit: float) -> NDArray[np.float64]:
        """Force on the vertex in [N], shape (3,).

        Args:
            points: Vertices of the surface now, in [mm], shape (p, 3).
            stiffness: Of the spring, in [N/m].
            limit: Largest force in [N].
        """
        stretch = (self.target - self.offset - points[self.vertex]) / MM
        force = stiffness * stretch
        size = float(np.linalg.norm(force))
        return np.asarray(force if size <= limit else force * (limit / size))
