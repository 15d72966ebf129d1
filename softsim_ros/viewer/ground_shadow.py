"""A soft shadow of the bodies on the floor: a small picture that lies there.

The page's own lamps throw none here: they look 20 units far, and the page's units are millimetres.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from softsim_core.arrays import BoolArray, IndexArray

CELLS: Final = 80
"""Pixels of the picture along each side."""
MARGIN: Final = 0.6
"""The picture reaches so much of the bodies' extent at rest beyond them on each side, or their height."""
BLUR: Final = 2.2
"""Standard deviation of its softness in pixels."""
MOST_PARTS: Final = 6
"""A triangle's edge is cut into so many parts at most, to find the pixels below it."""
PERIOD_S: Final = 0.2
DEPTH_MM: Final = 0.3
"""So far below the floor it lies: the grid is seen on it."""


def covered(points: NDArray[np.float32], middle: NDArray[np.float64], width: float) -> BoolArray:
    """Which pixels lie below points, shape (CELLS, CELLS): rows along y, columns along x.

    Args:
        points: What throws the shadow in [mm], shape (p, 3).
        middle: Of the picture, x and y in [mm], shape (2,).
        width: Of the picture in [mm].
    """
    cells = np.floor(((points[:, :2] - middle) / width + 0.5) * CELLS).astype(np.int64)
    inside = ((cells >= 0) & (cells < CELLS)).all(axis=1)
    pixels = np.zeros((CELLS, CELLS), bool)
    pixels[cells[inside, 1], cells[inside, 0]] = True
    return pixels


def shade(pixels: BoolArray) -> NDArray[np.float64]:
    """How dark each pixel is in 0..1 where some are covered, both of shape (CELLS, CELLS)."""
    return np.asarray(np.clip(1.6 * gaussian_filter(pixels.astype(float), BLUR), 0.0, 1.0))


def spread_over(points: NDArray[np.float32], triangles: IndexArray, pixel: float) -> NDArray[np.float32]:
    """Weights of the corners of each triangle at places a pixel in [mm] apart or so, shape (s, 3).

    The middle is among them; a mesh of many triangles has small ones and gets few places.
    """
    corners = points[triangles]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(initial=0.0)
    parts = int(np.clip(np.ceil(longest / pixel), 1, MOST_PARTS))
    first, second = np.divmod(np.arange((parts + 1) ** 2), parts + 1)
    inside = first + second <= parts
    weights = np.stack([first, second, parts - first - second], axis=1)[inside] / parts
    return np.concatenate([weights, np.full((1, 3), 1.0 / 3.0)]).astype(np.float32)


class GroundShadow:
    """See the module.

    Args:
        scene: viser's scene.

    Attributes:
        opacity: Of the darkest place, 0..1.
    """

    opacity = 0.5

    def __init__(self, scene: Any) -> None:
        self._scene = scene
        self._middle, self._width = np.zeros(2), 1.0
        self._drawn_at = -np.inf
        self._drawn: tuple[bytes, float] | None = None
        self._spread: NDArray[np.float32] | None = None
        self._picture: Any = None
        self._visible = True

    def begin(self, points: NDArray[np.float32], height: float) -> None:
        """Take other bodies, by their points at rest (p, 3) in [mm]; the floor is at `height` in [mm]."""
        if self._picture is not None:
            self._picture.remove()
            self._picture = None
        if not len(points):
            return
        lower, upper = points.min(axis=0).astype(float), points.max(axis=0).astype(float)
        self._middle = 0.5 * (lower + upper)[:2]
        across, along = float((upper - lower)[:2].max()), float((upper - lower)[2])
        self._width = max(across + 2.0 * max(MARGIN * across, along), 1.0)  # what stands up may bend over
        self._picture = self._scene.add_image(
            "/floor_shadow",
            np.zeros((CELLS, CELLS, 4), np.uint8),
            self._width,
            self._width,
            format="png",
            position=(*self._middle.tolist(), height - DEPTH_MM),
            cast_shadow=False,
            receive_shadow=False,
            visible=self._visible,
        )
        self._drawn_at, self._drawn, self._spread = -np.inf, None, None

    def switch(self, shown: bool) -> None:
        """Show or hide it."""
        self._visible = shown
        if self._picture is not None:
            self._picture.visible = shown

    def follow(self, points: NDArray[np.float32], triangles: IndexArray, now: float) -> None:
        """Draw the shadow of a surface (p, 3), (k, 3) as it is now, a few times per second; `now` in [s]."""
        if self._picture is None or not self._visible or now - self._drawn_at < PERIOD_S:
            return
        self._drawn_at = now
        if self._spread is None:
            self._spread = spread_over(points, triangles, self._width / CELLS)
        pixels = covered((self._spread @ points[triangles]).reshape(-1, 3), self._middle, self._width)
        if self._drawn != (drawn := (pixels.tobytes(), self.opacity)):  # what stands costs no picture
            self._drawn = drawn
            picture = np.zeros((CELLS, CELLS, 4), np.uint8)
            picture[..., 3] = np.rint(255.0 * self.opacity * shade(pixels))
            self._picture.image = picture
