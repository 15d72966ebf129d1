"""The surfaces that contact looks at, and the boxes with which its search begins."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from visualization_msgs.msg import Marker, MarkerArray

from softsim_core.scene.view import ViewSettings
from softsim_ros.viewer.marker_view import MarkerView, marker_points
from softsim_ros.viewer.shapes import box_lines
from softsim_ros.viewer.surface import MM

_BOX_COLOUR = (134, 142, 150)


class CollisionView:
    """Draws the topic `collisions`: wire frames of the surfaces, and a box around each.

    Args:
        scene: viser's scene.
    """

    def __init__(self, scene: Any) -> None:
        self._scene = scene
        self._surfaces = MarkerView(
            scene, "collisions", part_of=lambda name, _: f"collisions/{name}", wireframe=True
        )
        self._boxes: Any = None
        self._view = ViewSettings()

    def obey(self, view: ViewSettings) -> None:
        """Show what a view says."""
        self._view = view
        self._surfaces.switch(view.collisions, view.hidden)
        if not view.collisions:
            self._surfaces.clear()
        if not view.search_boxes:
            self._draw_boxes(np.zeros((0, 2, 3), np.float32))

    def update(self, message: MarkerArray) -> None:
        """Draw where the surfaces are now."""
        view = self._view
        if view.collisions:
            self._surfaces.update(message)
        if view.search_boxes:
            shown = [each for each in message.markers if f"collisions/{each.ns}" not in view.hidden]
            lines = [around(each) for each in shown]
            self._draw_boxes(np.concatenate([np.zeros((0, 2, 3), np.float32), *lines]))

    def _draw_boxes(self, lines: NDArray[np.float32]) -> None:
        if self._boxes is not None and len(self._boxes.points) == len(lines):
            self._boxes.points = lines
            return
        if self._boxes is not None:
            self._boxes.remove()
            self._boxes = None
        if len(lines):
            self._boxes = self._scene.add_line_segments("/search_boxes", lines, _BOX_COLOUR, thickness=0.3)


def around(marker: Marker) -> NDArray[np.float32]:
    """Edges in [mm] of the box around a surface, along the axes of the world, shape (12, 2, 3)."""
    points = marker_points(marker)
    margin = MM * marker.scale.x / 2.0 if marker.type == Marker.SPHERE else 0.0
    lower, upper = points.min(axis=0) - margin, points.max(axis=0) + margin
    lines = box_lines(tuple(0.5 * (lower + upper)), tuple(upper - lower), (0.0, 0.0, 0.0))
    return lines.astype(np.float32)
