"""Pulling on the body with the mouse: a spring from a vertex to the cursor, sent as a force while held."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from softsim_core.arrays import Array
from softsim_ros.client.simulator import Simulator
from softsim_ros.viewer.surface import MM

REPEAT_PERIOD_S = 0.05
"""The force is sent this often in [s]; the simulator lets go half a second after the last one."""

PULL_LIMIT_N = 2.0
"""Largest force of the mouse in [N]."""


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


class MousePull:
    """Sends the force of a pull to the simulator while it is held.

    Args:
        simulator: What is pulled.

    Attributes:
        stiffness: Of the spring between the body and the mouse, in [N/m].
    """

    def __init__(self, simulator: Simulator) -> None:
        self._simulator = simulator
        self.stiffness = 30.0

    def set_stiffness(self, stiffness: float) -> None:
        """Take another spring, in [N/m]."""
        self.stiffness = stiffness

    def send(self, pull: Pull | None, points: NDArray[np.float32], now: float) -> None:
        """Send the force of a pull, now and then.

        Args:
            pull: The pull; None: nothing is held.
            points: Vertices of the visible surface in [mm], shape (p, 3).
            now: Steady clock in [s].
        """
        if pull is not None and now - pull.sent_at >= REPEAT_PERIOD_S:
            pull.sent_at = now
            force: Array = pull.force(points, self.stiffness, PULL_LIMIT_N)
            self._simulator.pull(f"mesh_point/{pull.vertex}", force.tolist())
