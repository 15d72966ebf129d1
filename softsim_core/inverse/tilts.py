r"""Tilts of a plate: two angles about the world's x and y axes, and the turn about its own z that is left.

A rotation is written

    R = Rx(tilt_x) Rz(turn) Ry(tilt_y),

which in a frame with y up, its axes (x, y, z) being our (y, z, x), reads Rz Ry Rx: Euler angles about fixed
axes, of which the first is tilt_y and the third tilt_x.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from softsim_core.arrays import Array
from softsim_core.mechanics.pose import rotation_exp

X, Y, Z = np.eye(3)


class Tilts(NamedTuple):
    """Tilts about x and y and the turn about the plate's normal, all in [rad]."""

    x: float
    y: float
    turn: float


def tilt_rotation(tilt_x: float, tilt_y: float, turn: float = 0.0) -> Array:
    """Rotation matrix Rx(tilt_x) Rz(turn) Ry(tilt_y), shape (3, 3); angles in [rad]."""
    return np.asarray(rotation_exp(tilt_x * X) @ rotation_exp(turn * Z) @ rotation_exp(tilt_y * Y))


def tilts_of(rotation: Array) -> Tilts:
    """Tilts of a rotation matrix (3, 3): tilt_x and tilt_y in (-pi, pi], turn in [-pi/2, pi/2]."""
    return Tilts(
        x=math.atan2(rotation[2, 1], rotation[1, 1]),
        y=math.atan2(rotation[0, 2], rotation[0, 0]),
        turn=math.asin(min(max(-rotation[0, 1], -1.0), 1.0)),
    )
