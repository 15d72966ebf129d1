"""Control table of the XM servos (XM430, XM540): addresses, units, and what blocks of it say. Pure, no I/O.

Source: ROBOTIS e-Manual, "XM430-W210", section Control Table.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntFlag
from types import MappingProxyType

MODELS: Mapping[int, str] = MappingProxyType(
    {1020: "XM430-W350", 1030: "XM430-W210", 1120: "XM540-W270", 1130: "XM540-W150"}
)
"""Servos with this table and these units, by model number."""

LEAST_FIRMWARE = 38
"""Firmware from which there is a bus watchdog."""

POSITION_MODE = 3
"""Operating mode of positions within one turn."""

VELOCITY_UNIT = 0.229 * 2.0 * math.pi / 60.0
"""A velocity of 1 in [rad/s]."""

CURRENT_UNIT = 2.69e-3
"""A current of 1 in [A]."""

WATCHDOG_UNIT_S, WATCHDOG_TRIPPED = 0.020, 255
"""A bus watchdog of 1 in [s]; what it reads once it has stopped the servo."""

RETURN_DELAY_UNIT_S = 2e-6
"""A return delay of 1 in [s]."""

DRIVE_MODE_TIME_PROFILE = 0x04
"""Bit of the drive mode: profiles are times, not speeds."""

TORQUE_ENABLE, BUS_WATCHDOG, PROFILE, GOAL_POSITION = 64, 98, 108, 116
"""Addresses that are written; PROFILE is acceleration (4) and velocity (4)."""

SETTINGS, STATE, PRESENT = (0, 64), (64, 83), (126, 10)
"""Blocks that are read, as (address, size); their sizes differ, so that an answer says what it is."""


class HardwareError(IntFlag):
    """Bits of the hardware error status, and of the setting which of them switch the torque off."""

    INPUT_VOLTAGE = 0x01
    OVERHEATING = 0x04
    MOTOR_ENCODER = 0x08
    ELECTRICAL_SHOCK = 0x10
    OVERLOAD = 0x20

    def words(self) -> str:
        """The errors, in words; "none" without."""
        named = (str(each.name).lower().replace("_", " ") for each in HardwareError if each in self)
        return ", ".join(named) or "none"


@dataclass(frozen=True, slots=True)
class ServoSettings:
    """What a servo keeps without power.

    Attributes:
        model: Model number.
        firmware: Version.
        return_delay_s: Pause before each answer in [s].
        drive_mode: Bits.
        operating_mode: What goals mean.
        lowest, highest: Range of goals that the servo takes, in pulses.
        shutdown: Errors that switch the torque off.
    """

    model: int
    firmware: int
    return_delay_s: float
    drive_mode: int
    operating_mode: int
    lowest: int
    highest: int
    shutdown: HardwareError

    @property
    def kept(self) -> str:
        """What tells it from another servo, as far as it can be told."""
        return (
            f"model {self.model} firmware {self.firmware} mode {self.operating_mode}/{self.drive_mode}"
            f" range {self.lowest}..{self.highest}"
        )


@dataclass(frozen=True, slots=True)
class ServoState:
    """What a servo does and feels.

    Attributes:
        torque: Whether it has torque.
        hardware_error: What is wrong with it.
        watchdog: Its bus watchdog; `WATCHDOG_TRIPPED`: it has stopped.
        profile: Acceleration and velocity of its profile, raw.
        goal: Where it goes, in pulses.
        current: In [A].
        velocity: In [pulses/s].
        position: Where it stands, in pulses.
        voltage: Of its supply, in [V].
        temperature: In [degrees Celsius].
    """

    torque: bool
    hardware_error: HardwareError
    watchdog: int
    profile: tuple[int, int]
    goal: int
    current: float
    velocity: float
    position: int
    voltage: float
    temperature: int


def read_settings(block: bytes) -> ServoSettings:
    """Settings of a block SETTINGS."""
    model, firmware = struct.unpack_from("<H4xB", block, 0)
    delay, drive, mode = struct.unpack_from("<BBB", block, 9)
    highest, lowest = struct.unpack_from("<ii", block, 48)
    return ServoSettings(
        model, firmware, delay * RETURN_DELAY_UNIT_S, drive, mode, lowest, highest, _errors(block[63])
    )


def read_state(block: bytes) -> ServoState:
    """State of a block STATE."""
    start = STATE[0]
    acceleration, velocity, goal = struct.unpack_from("<iii", block, PROFILE - start)
    current, speed, position = read_present(block[PRESENT[0] - start :][: PRESENT[1]])
    voltage, temperature = struct.unpack_from("<HB", block, 144 - start)
    return ServoState(
        torque=bool(block[TORQUE_ENABLE - start]),
        hardware_error=_errors(block[70 - start]),
        watchdog=block[BUS_WATCHDOG - start],
        profile=(acceleration, velocity),
        goal=goal,
        current=current,
        velocity=speed,
        position=position,
        voltage=voltage / 10.0,
        temperature=temperature,
    )


def read_present(block: bytes) -> tuple[float, float, int]:
    """Current in [A], velocity in [pulses/s] and position in pulses of a block PRESENT."""
    current, velocity, position = struct.unpack("<hii", block)
    return current * CURRENT_UNIT, velocity * VELOCITY_UNIT * 4096.0 / (2.0 * math.pi), position


def four(number: int) -> bytes:
    """A number of the table in four bytes."""
    return number.to_bytes(4, "little", signed=True)


def _errors(value: int) -> HardwareError:
    known = sum(HardwareError)
    return HardwareError(value & known)
