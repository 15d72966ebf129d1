"""The serial board that drives a robot's servos, and the calibration of each servo."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

from softsim_core.base import FieldError, SceneError, need_positive


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoCalibration:
    """Calibration of a hobby servo: floor(sign * degrees + trim_deg) + zero_byte, clipped to the byte range.

    Attributes:
        joint: Name of the joint.
        zero_byte: Byte at joint angle 0.
        sign: +1 or -1.
        trim_deg: Mounting correction in [deg].
        byte_min, byte_max: Range of commanded bytes, within 0..180.
        rest_byte: Safe byte before start and after the end.
    """

    joint: str
    zero_byte: int = 179
    sign: Literal[1, -1] = 1
    trim_deg: float = 0.0
    byte_min: int = 60
    byte_max: int = 180
    rest_byte: int = 150

    def __post_init__(self) -> None:
        if not 0 <= self.byte_min <= self.rest_byte <= self.byte_max <= 180:
            raise SceneError(f"servo {self.joint}: needs 0 <= byte_min <= rest_byte <= byte_max <= 180")


@dataclass(frozen=True, slots=True, kw_only=True)
class BusServo:
    """Calibration of a bus servo: round(sign * angle * 4096 / 2 pi) + zero_pulse, with the angle in [rad].

    Such a servo has a number on the bus, measures its position, and takes goals of 4096 pulses per turn.
    Goals beyond its range, or beyond the joint's limits, are clipped.

    Attributes:
        joint: Name of the joint.
        id: Number on the bus, 0..252.
        zero_pulse: Pulse at joint angle 0.
        sign: +1 or -1.
        pulse_min, pulse_max: Range of commanded pulses, within 0..4095.
        rest_pulse: Safe pulse before start and after the end.
        speed: Speed limit of the servo itself in [rad/s], a second guard besides the joint's own limit.
        travel: Travel of the joint per [rad] of the servo, > 0: 1 for an angle, the radius in [m] of the drum
            that winds a cable.
    """

    joint: str
    id: int
    zero_pulse: int = 2048
    sign: Literal[1, -1] = 1
    pulse_min: int = 0
    pulse_max: int = 4095
    rest_pulse: int = 2048
    speed: float = 7.0
    travel: float = 1.0

    def __post_init__(self) -> None:
        if not 0 <= self.id <= 252:
            raise FieldError(f"servo {self.joint}", "id", self.id, "in 0..252")
        if not 0 <= self.pulse_min <= self.rest_pulse <= self.pulse_max <= 4095:
            raise SceneError(f"servo {self.joint}: needs 0 <= pulse_min <= rest_pulse <= pulse_max <= 4095")
        need_positive(f"servo {self.joint}", "speed", self.speed, "rad/s")
        need_positive(f"servo {self.joint}", "travel", self.travel, "rad or m per rad")


Servo: TypeAlias = ServoCalibration | BusServo


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardDescription:
    """The serial board that drives the servos, or the bus that connects them.

    Attributes:
        servos: Calibrations in packet order; either all have an `id` (bus servos) or none has.
        baud_rate: Bits per second.
        header: First byte of a packet of degree bytes; servo bytes never reach it.
        rate: Packets per second in [Hz].
        protocol: Name of the protocol; auto: the bridge detects it.
    """

    servos: tuple[Servo, ...]
    baud_rate: int = 115200
    header: int = 255
    rate: float = 50.0
    protocol: str = "auto"

    def __post_init__(self) -> None:
        if not self.baud_rate > 0:
            raise FieldError("board", "baud_rate", self.baud_rate, "> 0 bits/s")
        if not 180 < self.header <= 255:
            raise FieldError("board", "header", self.header, "in 181..255, above every servo byte")
        need_positive("board", "rate", self.rate, "Hz")
        if self.hobby_servos and self.bus_servos:
            raise SceneError("board: some servos have an id and some have none; give an id to all or to none")
        taken: dict[int, str] = {}
        for servo in self.bus_servos:
            if servo.id in taken:
                raise SceneError(
                    f"board: servos {taken[servo.id]} and {servo.joint} both have id {servo.id}; every servo"
                    " needs its own"
                )
            taken[servo.id] = servo.joint

    @property
    def hobby_servos(self) -> tuple[ServoCalibration, ...]:
        """The hobby servos in packet order; empty for a bus."""
        return tuple(each for each in self.servos if isinstance(each, ServoCalibration))

    @property
    def bus_servos(self) -> tuple[BusServo, ...]:
        """The bus servos in packet order; empty for hobby servos."""
        return tuple(each for each in self.servos if isinstance(each, BusServo))
