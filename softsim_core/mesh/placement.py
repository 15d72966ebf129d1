"""Placing points: scale, then rotate about the fixed x, then y, then z axis, then translate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from softsim_core.arrays import Array
from softsim_core.units import radians


class PlacementLike(Protocol):
    """What `place` needs; `softsim_core.scene.description.Placement` is one."""

    @property
    def scale(self) -> float:
        """Factor on all lengths."""

    @property
    def rotation_deg(self) -> tuple[float, float, float]:
        """Angles about the fixed x, y, z axes in [deg], applied in that order."""

    @property
    def translation(self) -> tuple[float, float, float]:
        """Shift in [m]."""


def rotation_matrix(rotation_deg: Sequence[float]) -> Array:
    """Rotation R = Rz(γ) Ry(β) Rx(α) for angles (α, β, γ) in [deg], exact at multiples of 90 degrees.

    Returns:
        Matrix, shape (3, 3); a point x becomes R x.
    """
    (ca, sa), (cb, sb), (cg, sg) = (_cosine_sine(angle) for angle in rotation_deg)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, ca, -sa], [0.0, sa, ca]])
    about_y = np.array([[cb, 0.0, sb], [0.0, 1.0, 0.0], [-sb, 0.0, cb]])
    about_z = np.array([[cg, -sg, 0.0], [sg, cg, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(about_z @ about_y @ about_x)


def place(points: Array, placement: PlacementLike | None) -> Array:
    """Points in [m] after a placement: R (scale x) + translation; None leaves them as they are.

    Args:
        points: Coordinates in file units, shape (n, 3).
        placement: Scale, rotation and translation.

    Returns:
        New array, shape (n, 3).
    """
    if placement is None:
        return points.copy()
    turned = (placement.scale * points) @ rotation_matrix(placement.rotation_deg).T
    return np.ascontiguousarray(turned + np.asarray(placement.translation, dtype=np.float64))


def _cosine_sine(angle_deg: float) -> tuple[float, float]:
    quarter = angle_deg / 90.0
    if quarter == round(quarter):
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[round(quarter) % 4]
    angle = radians(angle_deg)
    return float(np.cos(angle)), float(np.sin(angle))
