"""Pictures of a copy: surfaces drawn by matplotlib, from the farthest triangle to the nearest."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from softsim_core.base import Array, IndexArray, install_command
from softsim_core.lab.learning.tasks import Task
from softsim_core.physics.mechanics import rotation_of
from softsim_core.physics.mesh import SurfaceMesh, surface_of
from softsim_core.simulation.batch import Batch

SIZE = 400
"""Width and height of a picture in pixels."""
FEW = 600
"""Surfaces with fewer triangles are subdivided for drawing."""
_LIGHT = np.array([0.35, -0.5, 0.8])


class Painter:
    """Painter of the copies of a task's scene, with the task's camera.

    Raises:
        ImportError: matplotlib is not installed.
    """

    def __init__(self, task: Task, batch: Batch) -> None:
        try:
            from matplotlib.backends.backend_agg import FigureCanvasAgg
            from matplotlib.figure import Figure
        except ImportError as error:
            raise ImportError(
                f"render_mode needs matplotlib ({error}); {install_command('learn')}"
            ) from error
        azimuth, elevation, self._middle, self._width = task.camera
        a, e = np.radians((azimuth, elevation))
        towards = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        right = np.array([-np.sin(a), np.cos(a), 0.0])
        self._axes = np.stack([right, np.cross(towards, right), towards])
        self._batch, scene = batch, task.description().scene
        self._shapes = [(_fine(surface_of(each.shape)), each.colour) for each in scene.rigid_bodies]
        self._soft: Any = scene.bodies[0].colour if scene.bodies else None
        self._triangles: IndexArray = batch.call(0, "visual_triangles")
        self._canvas: Any = FigureCanvasAgg(Figure(figsize=(4.0, 4.0), dpi=SIZE / 4.0))
        self._plane: Any = self._canvas.figure.add_axes((0.0, 0.0, 1.0, 1.0))
        self._window: Any = None

    def paint(self, number: int) -> NDArray[np.uint8]:
        """Return a picture of a copy's present state, shape (SIZE, SIZE, 3), RGB."""
        from matplotlib.collections import PolyCollection

        poses = self._batch.call(number, "rigid_poses")
        soft = self._batch.call(number, "visual_points")[self._triangles]
        parts = [(soft, self._soft)]
        for pose, (shape, colour) in zip(poses, self._shapes, strict=True):
            parts.append((pose.position + shape @ rotation_of(pose.quaternion_xyzw).T, colour))
        corners = np.concatenate([each for each, _ in parts])
        colours = np.concatenate([np.tile(colour[:3], (len(each), 1)) for each, colour in parts])
        projected = (corners - np.array(self._middle)) @ self._axes.T
        order = np.argsort(projected[:, :, 2].mean(axis=1))
        shaded = colours * _shades(corners)[:, None]
        self._plane.clear()
        self._plane.add_collection(
            PolyCollection(
                projected[order, :, :2], facecolors=shaded[order], edgecolors="none", antialiaseds=False
            )
        )
        self._plane.set(xlim=(-self._width / 2, self._width / 2), ylim=(-self._width / 2, self._width / 2))
        self._plane.set_axis_off()
        self._canvas.draw()
        return np.asarray(self._canvas.buffer_rgba())[:, :, :3].copy()

    def show(self, number: int) -> None:
        """Show a copy's present state in a window."""
        from matplotlib import pyplot

        picture = self.paint(number)
        if self._window is None or not pyplot.fignum_exists(self._window.figure.number):
            pyplot.ion()
            _, plane = pyplot.subplots(num="softsim")
            plane.set_axis_off()
            self._window = plane.imshow(picture)
        self._window.set_data(picture)
        pyplot.pause(0.001)

    def close(self) -> None:
        """Close the window."""
        if self._window is not None:
            from matplotlib import pyplot

            pyplot.close(self._window.figure)
            self._window = None


def _fine(surface: SurfaceMesh) -> Array:
    """Return corners (m, 3, 3) of a surface; large triangles are subdivided to sort correctly by distance."""
    corners = surface.points[surface.triangles]
    while len(corners) < FEW:
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        corners = np.concatenate([np.stack(each, axis=1) for each in quarters])
    return corners


def _shades(corners: Array) -> Array:
    """Return the brightness of triangles (m, 3, 3), from 0.35 to 1, shape (m,)."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1)
    facing = np.abs(normal @ (_LIGHT / np.linalg.norm(_LIGHT))) / np.maximum(length, 1e-30)
    return np.asarray(0.35 + 0.65 * facing)
