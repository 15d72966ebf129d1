"""The serial board that drives a robot's servos, and the calibration of each servo."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from softsim_core.errors import SceneError
from softsim_core.values import FieldError, need_positive


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoCalibration:
    """From joint angle to a hobby servo's degree byte: floor(sign * degrees + trim_deg) + zero_byte, clipped.

    Attributes:
        joint: Name of the joint.
        zero_byte: Byte at joint angle 0.
        sign: +1 or -1.
        trim_deg: Mounting correction in [deg].
        byte_min, byte_max: Range the servo may be sent to, within 0..180.
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
class BoardDescription:
    """The serial board that drives the servos.

    Attributes:
        servos: Calibrations in packet order.
        baud_rate: Bits a second.
        header: First byte of a packet of degree bytes; servo bytes never reach it.
        rate: Packets a second in [Hz].
        protocol: Name of the protocol that it speaks; auto: the bridge finds out.
    """

    servos: tuple[ServoCalibration, ...]
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
