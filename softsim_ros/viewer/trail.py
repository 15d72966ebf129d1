"""The way that the effector has come, as a line."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from softsim_ros.viewer.surface import MM

MOST_POINTS: Final = 600
LEAST_STEP_MM: Final = 0.2
"""A place nearer than this to the last one adds nothing."""
COLOUR: Final = (240, 140, 0)


class Trail:
    """See the module.

    Args:
        scene: viser's scene.
    """

    def __init__(self, scene: Any) -> None:
        self._scene = scene
        self._points: deque[tuple[float, ...]] = deque(maxlen=MOST_POINTS)
        self._line: Any = None
        self._shown = False

    def switch(self, shown: bool) -> None:
        """Show or hide it; it goes on while it is hidden."""
        self._shown = shown
        self._draw()

    def add(self, position: Sequence[float]) -> None:
        """The effector is at a place in [m]."""
        point = tuple(MM * each for each in position)
        if self._points and np.linalg.norm(np.subtract(point, self._points[-1])) < LEAST_STEP_MM:
            return
        self._points.append(point)
        self._draw()

    def _draw(self) -> None:
        if self._line is not None:
            self._line.remove()
            self._line = None
        if self._shown and len(self._points) > 1:
            points = np.array(self._points, np.float32)
            self._line = self._scene.add_line_segments(
                "/trail", np.stack([points[:-1], points[1:]], axis=1), COLOUR, thickness=0.6
            )
