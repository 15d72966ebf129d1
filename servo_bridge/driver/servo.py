"""Conversion of joint angles to degree bytes, pulse widths or bus positions, and back. Pure functions.

byte = clip( floor( sign * (angle * 180 / pi) + trim_deg ) + zero_byte,  byte_min,  byte_max )

The order of operations is fixed: angle * 180 first, then / pi, both in double precision, so that the byte of
every angle is the same on every machine (math.degrees multiplies by a rounded 180 / pi and differs in the
last bit, which floor turns into a whole degree).

pulse = clip( round( sign * angle * 4096 / (2 pi) ) + zero_pulse,  pulse_min,  pulse_max )

An angle that is not finite, or a wrong number of angles, raises CommandError; a byte outside 0..180, or a
wrong number of bytes, raises PacketError. Nothing is converted then.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from servo_bridge import PacketError
from softsim_core.base import CommandError, SceneError
from softsim_core.physics.mechanics import JointLimits
from softsim_core.scene import BusServo, ServoCalibration

# A servo byte of `a` degrees is a pulse of 544 + a * 1856 / 180 in [us]
PULSE_MIN_US, PULSE_US_PER_180 = 544, 1856
_ANGLE_STEP = 2.0**-50  # a few units in the last place of an angle below 8 rad, in [rad]


def _degrees_on_servo(angle_rad: float, servo: ServoCalibration) -> float:
    """Return the degrees of the servo above its zero byte, before floor and clip."""
    return servo.sign * (angle_rad * 180.0 / math.pi) + servo.trim_deg


def _clipped_degrees(angle_rad: float, servo: ServoCalibration) -> float:
    """Return the degrees of the servo above its zero byte, clipped to its range."""
    # `BoardProtocol.encode` has checked poses; other callers would see infinity clipped to the servo's range.
    if not math.isfinite(angle_rad):
        raise CommandError(
            f"angle {angle_rad} for joint {servo.joint} refused: expected a finite number of radians"
        )
    lowest, highest = servo.byte_min - servo.zero_byte, servo.byte_max - servo.zero_byte
    return min(max(_degrees_on_servo(angle_rad, servo), lowest), highest)


def angle_to_byte(angle_rad: float, servo: ServoCalibration) -> int:
    """Return the degree byte of a joint angle in [rad], clipped to the servo's range."""
    # Clipping to whole numbers before floor gives the same byte and keeps 1e308 rad (inf degrees) in range.
    return math.floor(_clipped_degrees(angle_rad, servo)) + servo.zero_byte


def byte_to_angle(servo_byte: int, servo: ServoCalibration) -> float:
    """Return the nominal joint angle in [rad] of a degree byte: the lower edge of the byte's interval.

    It is the exact inverse: `angle_to_byte(byte_to_angle(b, servo), servo) == b` for every byte in range.
    """
    if not 0 <= servo_byte <= 180:
        raise PacketError(f"servo byte {servo_byte} for joint {servo.joint} refused: allowed are 0..180")
    whole = servo_byte - servo.zero_byte
    angle = servo.sign * (whole - servo.trim_deg) * math.pi / 180.0
    for _ in range(8):  # rounding may end just below the edge
        if _degrees_on_servo(angle, servo) >= whole:
            break
        angle += servo.sign * _ANGLE_STEP
    return angle


def angle_to_width(angle_rad: float, servo: ServoCalibration) -> int:
    """Return the pulse width in whole [us] of a joint angle in [rad], clipped to the servo's range.

    It is finer than a byte. At the nominal angle of a byte it is that byte's width, `byte_to_width`.
    """
    return round(byte_to_width(_clipped_degrees(angle_rad, servo) + servo.zero_byte))


def width_to_angle(width_us: float, servo: ServoCalibration) -> float:
    """Return the joint angle in [rad] at a pulse width in [us]."""
    return servo.sign * math.radians(width_to_byte(width_us) - servo.zero_byte - servo.trim_deg)


def width_limits(servo: ServoCalibration) -> tuple[int, int, int]:
    """Return the smallest, rest and largest pulse width in [us] of a servo."""
    least, rest, largest = map(byte_to_width, (servo.byte_min, servo.rest_byte, servo.byte_max))
    return round(least), round(rest), round(largest)


def angles_to_bytes(angles_rad: Sequence[float], servos: Sequence[ServoCalibration]) -> tuple[int, ...]:
    """Return degree bytes of joint angles in [rad], one per servo in packet order, clipped to its range."""
    if len(angles_rad) != len(servos):
        raise CommandError(
            f"packet of {len(angles_rad)} angles refused: the board has {len(servos)} servos"
            f" ({', '.join(servo.joint for servo in servos)})"
        )
    return tuple(angle_to_byte(angle, servo) for angle, servo in zip(angles_rad, servos, strict=True))


def bytes_to_angles(servo_bytes: Sequence[int], servos: Sequence[ServoCalibration]) -> tuple[float, ...]:
    """Return nominal joint angles in [rad] of the servo bytes of a packet without its header, in order."""
    if len(servo_bytes) != len(servos):
        raise PacketError(f"{len(servo_bytes)} servo bytes for {len(servos)} servos")
    return tuple(byte_to_angle(value, servo) for value, servo in zip(servo_bytes, servos, strict=True))


def byte_to_width(servo_byte: float) -> float:
    """Return the pulse width in [us] of a servo byte (degrees of the servo; need not be whole)."""
    return PULSE_MIN_US + servo_byte * PULSE_US_PER_180 / 180.0


def width_to_byte(width_us: float) -> float:
    """Return the degrees of the servo at a pulse width in [us]; the inverse of `byte_to_width`."""
    return (width_us - PULSE_MIN_US) * 180.0 / PULSE_US_PER_180


PULSES_PER_RAD = 4096.0 / (2.0 * math.pi)  # pulses per [rad]
_SLACK = 1e-9  # fraction of a pulse by which rounding may miss the pulse of a limit


def angle_to_pulse(angle_rad: float, servo: BusServo) -> int:
    """Return the pulse of a joint angle in [rad], rounded, clipped to the servo's range."""
    if not math.isfinite(angle_rad):
        raise CommandError(
            f"angle {angle_rad} for joint {servo.joint} refused: expected a finite number of radians"
        )
    lowest, highest = servo.pulse_min - servo.zero_pulse, servo.pulse_max - servo.zero_pulse
    return round(min(max(servo.sign * angle_rad * PULSES_PER_RAD, lowest), highest)) + servo.zero_pulse


def pulse_to_angle(pulse: float, servo: BusServo) -> float:
    """Return the joint angle in [rad] of a pulse; inverts `angle_to_pulse` within the servo's range."""
    return servo.sign * (pulse - servo.zero_pulse) / PULSES_PER_RAD


def within(servo: BusServo, limits: JointLimits) -> BusServo:
    """Return the servo with its pulse range narrowed to the limits of a joint.

    Raises:
        SceneError: its rest pulse lies outside of them.
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
