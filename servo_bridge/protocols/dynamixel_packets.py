"""Packets of the Dynamixel protocol 2.0, and the control table of the XM servos. Pure functions.

FF FF FD 00, id, length (2), instruction, parameters, CRC-16 (2)

Numbers of several bytes begin with the low byte. The length counts the bytes that follow it. If instruction
and parameters contain FF FF FD, another FD is inserted, so that a header occurs nowhere else; length and CRC
include it. A status packet has the instruction 0x55, and an error byte before its parameters. The CRC-16
(polynomial 0x8005, initial value 0, high bit first) runs from the header to the last parameter.

Source: ROBOTIS e-Manual, "DYNAMIXEL Protocol 2.0"; "XM430-W210", section Control Table.

The packets are made here and not by the servo makers' dynamixel-sdk (4.1.0): it sends a body that holds
FF FF FD without its stuffing, reads only from a blocking port, and loses packets behind a damaged one.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from types import MappingProxyType

from servo_bridge import PacketError

HEADER = b"\xff\xff\xfd\x00"  # first bytes of a packet
BROADCAST = 0xFE  # id that addresses all servos of a bus
LARGEST_ID = 252  # largest id of a servo; the smallest is 0
ALERT = 0x80  # bit of the error byte: the servo has a hardware error
_STUFFED, _PATTERN = b"\xff\xff\xfd\xfd", b"\xff\xff\xfd"
_BEFORE_INSTRUCTION = len(HEADER) + 3
_LEAST_LENGTH, _LARGEST_LENGTH = 3, 1024


class Instruction(IntEnum):
    """Instruction of a packet, or STATUS for a response."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REBOOT = 0x08
    STATUS = 0x55
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83
    BULK_READ = 0x92


class StatusError(IntEnum):
    """Why a servo refuses an instruction: the low seven bits of the error byte."""

    RESULT_FAIL = 1
    INSTRUCTION = 2
    CRC = 3
    DATA_RANGE = 4
    DATA_LENGTH = 5
    DATA_LIMIT = 6
    ACCESS = 7


@dataclass(frozen=True, slots=True)
class Packet:
    """A whole packet with its stuffing removed."""

    servo_id: int  # servo that it addresses, or that responds
    instruction: int  # instruction byte
    parameters: bytes = b""  # parameters; of a status packet without the error byte
    error: int = 0  # error byte of a status packet; 0 of any other


def _crc_table() -> tuple[int, ...]:
    table = []
    for value in range(256):
        crc = value << 8
        for _ in range(8):
            crc = (crc << 1) ^ 0x8005 if crc & 0x8000 else crc << 1
        table.append(crc & 0xFFFF)
    return tuple(table)


_CRC_TABLE = _crc_table()


def crc16(data: bytes) -> int:
    """Return the CRC-16 of some bytes."""
    crc = 0
    for value in data:
        crc = ((crc << 8) & 0xFFFF) ^ _CRC_TABLE[(crc >> 8) ^ value]
    return crc


def packet(servo_id: int, instruction: int, parameters: bytes = b"") -> bytes:
    """Return the bytes of a packet, stuffed, with length and CRC.

    Raises:
        PacketError: the id is not allowed, or there are too many parameters.
    """
    if not (0 <= servo_id <= LARGEST_ID or servo_id == BROADCAST):
        raise PacketError(f"servo id {servo_id} refused: allowed are 0..{LARGEST_ID}, {BROADCAST} for all")
    body = (bytes([instruction]) + parameters).replace(_PATTERN, _STUFFED)
    length = len(body) + 2
    if length > _LARGEST_LENGTH:
        raise PacketError(f"{len(parameters)} parameters refused: a packet is at most {_LARGEST_LENGTH} long")
    checked = HEADER + bytes([servo_id]) + length.to_bytes(2, "little") + body
    return checked + crc16(checked).to_bytes(2, "little")


def status(servo_id: int, parameters: bytes = b"", error: int = 0) -> bytes:
    """Return a status packet: the response of a servo."""
    return packet(servo_id, Instruction.STATUS, bytes([error]) + parameters)


def ping(servo_id: int) -> bytes:
    """Return a ping; the response has model number (2) and firmware version (1)."""
    return packet(servo_id, Instruction.PING)


def sync_write(address: int, data: Mapping[int, bytes]) -> bytes:
    """Return a packet that writes bytes of one length to the same address of several servos, by id.

    There is no response.

    Raises:
        PacketError: the lengths differ, or there is no servo.
    """
    sizes = {len(each) for each in data.values()}
    if len(sizes) != 1:
        raise PacketError(
            f"a sync write of {sorted(sizes)} bytes refused: it needs one length for all servos"
        )
    body = b"".join(bytes([servo_id]) + each for servo_id, each in data.items())
    return packet(BROADCAST, Instruction.SYNC_WRITE, _two(address) + _two(sizes.pop()) + body)


def bulk_read(places: Mapping[int, tuple[int, int]]) -> bytes:
    """Return a request to several servos, by id, for (address, size) each; they respond in this order."""
    asked = (bytes([servo_id]) + _two(place[0]) + _two(place[1]) for servo_id, place in places.items())
    return packet(BROADCAST, Instruction.BULK_READ, b"".join(asked))


class PacketStream:
    """Parser that finds whole packets in received bytes: damaged, cut anywhere, or of no packet at all.

    Attributes:
        damaged: Number of packets dropped for a wrong CRC or length.
    """

    def __init__(self) -> None:
        self.damaged = 0
        self._data = bytearray()

    def feed(self, data: bytes) -> list[Packet]:
        """Return the packets that these bytes complete, oldest first; never raises.

        In a damaged packet the search for the next header begins at its second byte.
        """
        self._data += data
        found: list[Packet] = []
        while (end := self._whole()) is not None:
            data = bytes(self._data[:end])
            whole = end > 0 and crc16(data[:-2]) == int.from_bytes(data[-2:], "little")
            body = data[_BEFORE_INSTRUCTION:-2].replace(_STUFFED, _PATTERN)
            is_status = whole and body[0] == Instruction.STATUS
            if not whole or (is_status and len(body) < 2):  # a status has an error byte
                self.damaged += 1
                del self._data[:1]
                continue
            del self._data[:end]
            error, parameters = (body[1], body[2:]) if is_status else (0, body[1:])
            found.append(Packet(data[4], body[0], parameters, error))
        return found

    def _whole(self) -> int | None:
        """Return the length of the packet at the start of the buffer; 0: invalid; None: bytes are missing."""
        start = self._data.find(HEADER)
        if start < 0:  # the last bytes may begin a header
            tail = next((n for n in (3, 2, 1) if self._data.endswith(HEADER[:n])), 0)
            del self._data[: len(self._data) - tail]
            return None
        del self._data[:start]
        if len(self._data) < _BEFORE_INSTRUCTION:
            return None
        length = int.from_bytes(self._data[5:7], "little")
        is_id = self._data[4] <= LARGEST_ID or self._data[4] == BROADCAST
        if not is_id or not _LEAST_LENGTH <= length <= _LARGEST_LENGTH:
            return 0
        end = _BEFORE_INSTRUCTION + length
        if self._data.find(HEADER, len(HEADER), end - 2) >= 0:
            return 0  # stuffing keeps headers out of packets, but for the CRC: this one was cut short
        return end if len(self._data) >= end else None


def _two(number: int) -> bytes:
    return number.to_bytes(2, "little")


# Servos with this control table and these units, by model number
MODELS: Mapping[int, str] = MappingProxyType(
    {1020: "XM430-W350", 1030: "XM430-W210", 1120: "XM540-W270", 1130: "XM540-W150"}
)

LEAST_FIRMWARE = 38  # first firmware version with a bus watchdog
POSITION_MODE = 3  # operating mode for positions within one turn
VELOCITY_UNIT = 0.229 * 2.0 * math.pi / 60.0  # unit of velocities in [rad/s]
CURRENT_UNIT = 2.69e-3  # unit of currents in [A]
# Unit of the bus watchdog in [s], and its value once it has stopped the servo
WATCHDOG_UNIT_S, WATCHDOG_TRIPPED = 0.020, 255
DRIVE_MODE_TIME_PROFILE = 0x04  # bit of the drive mode: profiles are times, not speeds
# Addresses that are written; PROFILE is acceleration (4) and velocity (4)
TORQUE_ENABLE, BUS_WATCHDOG, PROFILE, GOAL_POSITION = 64, 98, 108, 116

# Blocks that are read, as (address, size); their sizes differ, so that a response shows which one it is
SETTINGS, STATE, PRESENT = (0, 64), (64, 83), (126, 10)


class HardwareError(IntFlag):
    """Bits of the hardware error status, and of the setting that says which of them switch the torque off."""

    INPUT_VOLTAGE = 0x01
    OVERHEATING = 0x04
    MOTOR_ENCODER = 0x08
    ELECTRICAL_SHOCK = 0x10
    OVERLOAD = 0x20

    def words(self) -> str:
        """Return the errors in words; "none" without any."""
        named = (str(each.name).lower().replace("_", " ") for each in HardwareError if each in self)
        return ", ".join(named) or "none"


@dataclass(frozen=True, slots=True)
class ServoSettings:
    """Settings that a servo stores without power."""

    model: int
    firmware: int
    drive_mode: int  # bits
    operating_mode: int  # quantity that goals command
    lowest: int  # goal that the servo takes, in pulses
    highest: int
    shutdown: HardwareError  # errors that switch the torque off

    @property
    def identity_text(self) -> str:
        """Settings that distinguish it from other servos, as far as possible, as text."""
        return (
            f"model {self.model} firmware {self.firmware} mode {self.operating_mode}/{self.drive_mode}"
            f" range {self.lowest}..{self.highest}"
        )


@dataclass(frozen=True, slots=True)
class ServoState:
    """State and measurements of a servo."""

    torque: bool
    hardware_error: HardwareError
    watchdog: int  # WATCHDOG_TRIPPED if it has stopped the servo
    profile: tuple[int, int]  # acceleration and velocity, raw
    goal: int  # in pulses
    current: float  # in [A]
    position: int  # in pulses
    voltage: float  # in [V]
    temperature: int  # in [degrees Celsius]


def read_settings(block: bytes) -> ServoSettings:
    """Parse a block SETTINGS."""
    model, firmware = struct.unpack_from("<H4xB", block, 0)
    drive, mode = struct.unpack_from("<BB", block, 10)
    highest, lowest = struct.unpack_from("<ii", block, 48)
    return ServoSettings(model, firmware, drive, mode, lowest, highest, _errors(block[63]))


def read_state(block: bytes) -> ServoState:
    """Parse a block STATE."""
    start = STATE[0]
    acceleration, velocity, goal = struct.unpack_from("<iii", block, PROFILE - start)
    current, position = read_present(block[PRESENT[0] - start :][: PRESENT[1]])
    voltage, temperature = struct.unpack_from("<HB", block, 144 - start)
    return ServoState(
        torque=bool(block[TORQUE_ENABLE - start]),
        hardware_error=_errors(block[70 - start]),
        watchdog=block[BUS_WATCHDOG - start],
        profile=(acceleration, velocity),
        goal=goal,
        current=current,
        position=position,
        voltage=voltage / 10.0,
        temperature=temperature,
    )


def read_present(block: bytes) -> tuple[float, int]:
    """Return current in [A] and position in pulses of a block PRESENT, which has the velocity in between."""
    current, position = struct.unpack("<h4xi", block)
    return current * CURRENT_UNIT, position


def four(number: int) -> bytes:
    """Return a number of the control table as four bytes."""
    return number.to_bytes(4, "little", signed=True)


def _errors(value: int) -> HardwareError:
    return HardwareError(value & sum(HardwareError))  # other bits have no meaning
