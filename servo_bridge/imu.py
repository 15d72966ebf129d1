"""An IMU reading of the board as a ROS message."""

from __future__ import annotations

import math
from typing import Any

from sensor_msgs.msg import Imu

from servo_bridge.protocols import TiltReading

TILT_VARIANCE = math.radians(1.0) ** 2
"""Variance in [rad^2] of a tilt: about a degree, as small IMUs with sensor fusion state."""

HEADING_VARIANCE = math.pi**2
"""Variance in [rad^2] of the heading, which is not measured."""


def imu_message(reading: TiltReading, frame: str, stamp: Any) -> Imu:
    """Orientation of the two tilts; rates and accelerations are marked as absent (first covariance -1).

    Args:
        reading: Tilts in [rad].
        frame: Frame of the sensor.
        stamp: Time of the reading, builtin_interfaces/Time.
    """
    message = Imu()
    message.header.stamp, message.header.frame_id = stamp, frame
    orientation = message.orientation
    orientation.x, orientation.y, orientation.z, orientation.w = reading.quaternion_xyzw()
    message.orientation_covariance = [
        TILT_VARIANCE,
        0.0,
        0.0,
        0.0,
        TILT_VARIANCE,
        0.0,
        0.0,
        0.0,
        HEADING_VARIANCE,
    ]
    message.angular_velocity_covariance = [-1.0, *[0.0] * 8]
    message.linear_acceleration_covariance = [-1.0, *[0.0] * 8]
    return message
