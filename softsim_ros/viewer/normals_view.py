"""Directions in which the visible surfaces face."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from softsim_core.arrays import IndexArray
from softsim_ros.viewer.shapes import normal_lines

LENGTH_MM: Final = 2.0
PERIOD_S: Final = 0.2
"""Normals are drawn anew this often, in [s]."""

_COLOUR = (12, 133, 153)


class NormalsView:
    """Draws a line from the middle of each triangle along its normal.

    Args:
        scene: viser's scene.
    """

    def __init__(self, scene: Any) -> None:
        self._scene, self._lines = scene, None
        self._drawn_at = -math.inf
        self.visible = False

    def switch(self, shown: bool) -> None:
        """Show or hide them."""
        self.visible, self._drawn_at = shown, -math.inf
        if not shown:
            self._remove()

    def update(self, points: NDArray[np.float32], triangles: IndexArray, now: float) -> None:
        """Draw those of `triangles` (k, 3) over `points` (p, 3) in [mm], when it is time; `now` in [s]."""
        if not self.visible or now - self._drawn_at < PERIOD_S:
            return
        self._drawn_at = now
        lines = normal_lines(points, triangles, LENGTH_MM)
        if self._lines is not None and len(self._lines.points) == len(lines):
            self._lines.points = lines
            return
        self._remove()
        if len(lines):
            self._lines = self._scene.add_line_segments("/normals", lines, _COLOUR, thickness=0.15)

    def _remove(self) -> None:
        if self._lines is not None:
            self._lines.remove()
            self._lines = None
