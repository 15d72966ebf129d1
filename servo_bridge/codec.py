"""The board's legacy packet: header 255, then one degree byte a servo. Pure functions, no I/O.

    byte = clip( floor( sign * (angle * 180 / pi) + trim_deg ) + zero_byte,  byte_min,  byte_max )

The order of operations is part of the protocol: angle * 180 first, then / pi, both in double precision, so
that the byte of every angle is the same on every machine (math.degrees multiplies by a rounded 180 / pi and
differs in the last bit, which floor turns into a whole degree).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from servo_bridge.errors import PacketError
from servo_bridge.frames import byte_to_width, width_to_byte
from softsim_core.errors import CommandError
from softsim_core.scene.description import ServoCalibration

HEADER = 255
"""First byte of a packet; servo bytes never reach it."""

BYTE_LOW, BYTE_HIGH = 60, 180
"""Range of servo bytes that the board's own parser accepts."""

PARTIAL_TIMEOUT_S = 0.040
"""Age in [s] at which the board drops a packet that is not complete."""

BOOT_LOADER_BYTE = 100
"""0x64, the boot loader's "program a page": received first after a reset it erases the firmware's start."""

_ANGLE_STEP = 2.0**-50
"""One or a few units in the last place of an angle below 8 rad, in [rad]."""


def _degrees_on_servo(angle_rad: float, servo: ServoCalibration) -> float:
    """Degrees of the servo above its zero byte, before floor and clip."""
    return servo.sign * (angle_rad * 180.0 / math.pi) + servo.trim_deg


def angle_to_byte(angle_rad: float, servo: ServoCalibration) -> int:
    """Degree byte of a joint angle in [rad], clipped to the servo's range.

    Raises:
        CommandError: the angle is not a finite number.
    """
    if not math.isfinite(angle_rad):
        raise CommandError(
            f"angle {angle_rad} for joint {servo.joint} refused: expected a finite number of radians"
        )
    lowest, highest = servo.byte_min - servo.zero_byte, servo.byte_max - servo.zero_byte
    # Clipping to whole numbers before floor gives the same byte and keeps 1e308 rad (inf degrees) in range.
    return math.floor(min(max(_degrees_on_servo(angle_rad, servo), lowest), highest)) + servo.zero_byte


def byte_to_angle(servo_byte: int, servo: ServoCalibration) -> float:
    """Nominal joint angle in [rad] of a degree byte: the lower edge of the byte's interval of servo degrees.

    It is the exact inverse: `angle_to_byte(byte_to_angle(b, servo), servo) == b` for every byte in range.

    Raises:
        PacketError: the byte lies outside 0..180.
    """
    if not 0 <= servo_byte <= 180:
        raise PacketError(f"servo byte {servo_byte} for joint {servo.joint} refused: allowed are 0..180")
    whole = servo_byte - servo.zero_byte
    angle = servo.sign * (whole - servo.trim_deg) * math.pi / 180.0
    for _ in range(8):  # rounding may land just below the edge; a few last-place steps bring it onto it
        if _degrees_on_servo(angle, servo) >= whole:
            break
        angle += servo.sign * _ANGLE_STEP
    return angle


def angle_to_width(angle_rad: float, servo: ServoCalibration) -> int:
    """Pulse width in whole [us] of a joint angle in [rad], clipped to the servo's range; finer than a byte.

    At the nominal angle of a byte it is that byte's width, `frames.byte_to_width`.

    Raises:
        CommandError: the angle is not a finite number.
    """
    angle_to_byte(angle_rad, servo)  # refuses what is not finite
    lowest, highest = servo.byte_min - servo.zero_byte, servo.byte_max - servo.zero_byte
    return round(
        byte_to_width(min(max(_degrees_on_servo(angle_rad, servo), lowest), highest) + servo.zero_byte)
    )


def width_to_angle(width_us: float, servo: ServoCalibration) -> float:
    """Joint angle in [rad] at a pulse width in [us]."""
    return servo.sign * math.radians(width_to_byte(width_us) - servo.zero_byte - servo.trim_deg)


def width_limits(servo: ServoCalibration) -> tuple[int, int]:
    """Smallest and largest pulse width in [us] that `angle_to_width` gives."""
    return round(byte_to_width(servo.byte_min)), round(byte_to_width(servo.byte_max))


def encode_packet(
    angles_rad: Sequence[float], servos: Sequence[ServoCalibration], header: int = HEADER
) -> bytes:
    """Packet for joint angles in [rad], one a servo in packet order: header, then one degree byte a servo.

    Raises:
        CommandError: wrong number of angles, or one that is not finite; nothing is encoded.
    """
    if len(angles_rad) != len(servos):
        raise CommandError(
            f"packet of {len(angles_rad)} angles refused: the board has {len(servos)} servos"
            f" ({', '.join(servo.joint for servo in servos)})"
        )
    return bytes(
        [header, *(angle_to_byte(angle, servo) for angle, servo in zip(angles_rad, servos, strict=True))]
    )


def rest_packet(servos: Sequence[ServoCalibration], header: int = HEADER) -> bytes:
    """Packet of the safe pose: every servo at its rest byte."""
    return bytes([header, *(servo.rest_byte for servo in servos)])


def bytes_to_angles(servo_bytes: Sequence[int], servos: Sequence[ServoCalibration]) -> tuple[float, ...]:
    """Nominal joint angles in [rad] of the servo bytes of a packet (header not included), in packet order.

    Raises:
        PacketError: wrong number of bytes, or one outside 0..180.
    """
    if len(servo_bytes) != len(servos):
        raise PacketError(f"{len(servo_bytes)} servo bytes for {len(servos)} servos")
    return tuple(byte_to_angle(value, servo) for value, servo in zip(servo_bytes, servos, strict=True))


def avoid_byte_100(packet: bytes, servos: Sequence[ServoCalibration]) -> bytes:
    """The packet with every servo byte 100 replaced by 101 (by 99 for a servo that may not go beyond 100).

    A board that is reset in the middle of a packet runs its boot loader first; if the first byte it then sees
    is 100, the boot loader erases the start of the firmware and the board is dead until the next upload. One
    degree is the dead band of a hobby servo, so nothing is lost.
    """
    if BOOT_LOADER_BYTE not in packet[1:]:
        return packet
    above = BOOT_LOADER_BYTE + 1
    below = BOOT_LOADER_BYTE - 1
    return packet[:1] + bytes(
        value if value != BOOT_LOADER_BYTE else (above if servo.byte_max >= above else below)
        for value, servo in zip(packet[1:], servos, strict=True)
    )


def decode_packet(packet: bytes, servo_count: int, header: int = HEADER) -> tuple[int, ...]:
    """Servo bytes of one whole packet.

    Raises:
        PacketError: wrong length, wrong header, or a servo byte outside 60..180.
    """
    if len(packet) != servo_count + 1 or packet[0] != header:
        raise PacketError(
            f"{packet.hex(' ') or 'no bytes'}: expected {header:02x} and {servo_count} servo bytes"
        )
    for value in packet[1:]:
        if not BYTE_LOW <= value <= BYTE_HIGH:
            raise PacketError(f"{packet.hex(' ')}: servo byte {value} lies outside {BYTE_LOW}..{BYTE_HIGH}")
    return tuple(packet[1:])


@dataclass(slots=True)
class PacketParser:
    """The board's side of the protocol, byte by byte, on a clock that is passed in.

    The header always starts a new packet; a byte outside 60..180 drops the packet; so does an age of 40 ms.

    Attributes:
        servo_count: Servo bytes in a packet.
        header: First byte of a packet.
        accepted: Packets accepted so far.
        dropped: Packets dropped so far (cut short by a new header, out of range, or too old).
    """

    servo_count: int = 3
    header: int = HEADER
    accepted: int = 0
    dropped: int = 0
    _partial: bytearray | None = field(default=None, repr=False)
    _started: float = field(default=0.0, repr=False)

    def reset(self) -> None:
        """Forget a packet begun, as a reset of the board does; the counters stay."""
        self._partial = None

    def feed(self, data: bytes, now: float) -> list[tuple[int, ...]]:
        """Packets completed by bytes received at the time `now` in [s] (any steady clock), oldest first."""
        packets: list[tuple[int, ...]] = []
        for value in data:
            packet = self._take(value, now)
            if packet is not None:
                packets.append(packet)
        return packets

    def _take(self, value: int, now: float) -> tuple[int, ...] | None:
        if self._partial is not None and now - self._started > PARTIAL_TIMEOUT_S:
            self._drop()
        if value == self.header:
            if self._partial is not None:
                self._drop()
            self._partial, self._started = bytearray(), now
        elif self._partial is not None:
            if BYTE_LOW <= value <= BYTE_HIGH:
                self._partial.append(value)
            else:
                self._drop()
        if self._partial is None or len(self._partial) < self.servo_count:
            return None
        packet, self._partial = tuple(self._partial), None
        self.accepted += 1
        return packet

    def _drop(self) -> None:
        self._partial = None
        self.dropped += 1
