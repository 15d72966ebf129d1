"""Tilts of measured orientations: of an IMU by the direction of gravity, of a pose by its axes."""

from __future__ import annotations

import math

import numpy as np
from geometry_msgs.msg import Quaternion, Vector3Stamped
from sensor_msgs.msg import Imu

from softsim_core.arrays import Array
from softsim_core.errors import CommandError
from softsim_core.inverse.tilts import Tilts, tilts_of
from softsim_core.mechanics.pose import rotation_of

UNIT_WITHIN = 0.1
"""A quaternion whose length differs from 1 by more than this is no orientation."""


def rotation(message: Quaternion) -> Array:
    """Rotation matrix (3, 3) of a quaternion message.

    Raises:
        CommandError: not finite, or its length is not 1.
    """
    quaternion = np.array([message.x, message.y, message.z, message.w])
    length = float(np.linalg.norm(quaternion))
    if not abs(length - 1.0) <= UNIT_WITHIN:  # also catches NaN and infinity
        raise CommandError(f"orientation {quaternion.tolist()} is no unit quaternion (x, y, z, w)")
    return rotation_of(quaternion / length)


def pose_tilts(message: Quaternion) -> Tilts:
    """Tilts and turn of an orientation in the world.

    Raises:
        CommandError: no unit quaternion.
    """
    return tilts_of(rotation(message))


def imu_tilts(message: Imu) -> Array:
    """Tilts about x and y in [rad] of an IMU on the plate, shape (2,): how it stands to gravity.

    The heading of its orientation does not matter, so it needs no magnetometer.

    Raises:
        CommandError: it has no orientation (first covariance -1), or no unit quaternion.
    """
    if message.orientation_covariance[0] == -1.0:
        raise CommandError("the message has no orientation (orientation_covariance[0] is -1)")
    up = rotation(message.orientation)[2]  # the world's z in the frame of the sensor
    return np.array([math.asin(min(max(up[1], -1.0), 1.0)), math.atan2(-up[0], up[2])])


def reference_tilts(message: Vector3Stamped) -> Array:
    """Tilts about x and y in [rad] of a reference, shape (2,); its z is not used.

    Raises:
        CommandError: not finite.
    """
    tilts = np.array([message.vector.x, message.vector.y])
    if not np.isfinite(tilts).all():
        raise CommandError(f"tilt reference refused: {tilts.tolist()} rad is not finite; nothing was changed")
    return tilts
