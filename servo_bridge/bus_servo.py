"""A servo on a bus: joint angle to pulse and back, and how far it may go. Pure functions, no I/O.

pulse = clip( round( sign * angle * 4096 / (2 pi) ) + zero_pulse,  pulse_min,  pulse_max )
"""

from __future__ import annotations

import math
from dataclasses import replace

from softsim_core.errors import CommandError, SceneError
from softsim_core.mechanics.limits import JointLimits
from softsim_core.scene.board import BusServo

PULSES_PER_RAD = 4096.0 / (2.0 * math.pi)
"""Pulses of one [rad]."""

_SLACK = 1e-9
"""Part of a pulse by which rounding may miss the pulse of a limit."""


def angle_to_pulse(angle_rad: float, servo: BusServo) -> int:
    """Pulse of a joint angle in [rad], rounded, clipped to the servo's range.

    Raises:
        CommandError: the angle is not a finite number.
    """
    if not math.isfinite(angle_rad):
        raise CommandError(
            f"angle {angle_rad} for joint {servo.joint} refused: expected a finite number of radians"
        )
    lowest, highest = servo.pulse_min - servo.zero_pulse, servo.pulse_max - servo.zero_pulse
    return round(min(max(servo.sign * angle_rad * PULSES_PER_RAD, lowest), highest)) + servo.zero_pulse


def pulse_to_angle(pulse: float, servo: BusServo) -> float:
    """Joint angle in [rad] of a pulse; the inverse of `angle_to_pulse` within the servo's range."""
    return servo.sign * (pulse - servo.zero_pulse) / PULSES_PER_RAD


def within(servo: BusServo, limits: JointLimits) -> BusServo:
    """The servo with no pulse left in its range that lies outside a joint's limits.

    Raises:
        SceneError: its rest pulse lies outside.
    """
    ends = sorted(
        servo.sign * end * PULSES_PER_RAD + servo.zero_pulse for end in (limits.lower, limits.upper)
    )
    low = servo.pulse_min if ends[0] == -math.inf else max(servo.pulse_min, math.ceil(ends[0] - _SLACK))
    high = servo.pulse_max if ends[1] == math.inf else min(servo.pulse_max, math.floor(ends[1] + _SLACK))
    if not low <= servo.rest_pulse <= high:
        raise SceneError(
            f"servo {servo.joint}: rest_pulse {servo.rest_pulse} is outside what limits and range allow,"
            f" {low}..{high}; change rest_pulse or the limits"
        )
    return replace(servo, pulse_min=low, pulse_max=high)
