"""Packets of the Dynamixel protocol 2.0 on a bus of servos: built, found in a stream, checked. Pure, no I/O.

    FF FF FD 00, id, length (2), instruction, parameters, CRC-16 (2)

Numbers of several bytes begin with the low one. The length counts what follows it. Where instruction and
parameters contain FF FF FD, another FD is put in, so that a header occurs nowhere else; length and CRC count
it. A status packet has the instruction 0x55, and an error byte before its parameters. The CRC-16 (polynomial
0x8005, initial value 0, high bit first) runs from the header to the last parameter.

Source: ROBOTIS e-Manual, "DYNAMIXEL Protocol 2.0".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

from servo_bridge.errors import PacketError

HEADER = b"\xff\xff\xfd\x00"
"""First bytes of a packet."""

BROADCAST = 0xFE
"""Id of all servos of a bus."""

LARGEST_ID = 252
"""Ids of servos run from 0 to this."""

ALERT = 0x80
"""Bit of the error byte: the servo has a hardware error."""

_STUFFED, _PATTERN = b"\xff\xff\xfd\xfd", b"\xff\xff\xfd"
_BEFORE_INSTRUCTION = len(HEADER) + 3
_LEAST_LENGTH, _LARGEST_LENGTH = 3, 1024


class Instruction(IntEnum):
    """What a packet asks, or that it answers."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REBOOT = 0x08
    STATUS = 0x55
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83
    BULK_READ = 0x92


class StatusError(IntEnum):
    """What a servo has against an instruction: the low seven bits of the error byte."""

    RESULT_FAIL = 1
    INSTRUCTION = 2
    CRC = 3
    DATA_RANGE = 4
    DATA_LENGTH = 5
    DATA_LIMIT = 6
    ACCESS = 7


@dataclass(frozen=True, slots=True)
class Packet:
    """A whole packet, its stuffing taken out.

    Attributes:
        servo_id: Whom it is for, or who answers.
        instruction: What it asks, as its byte.
        parameters: What follows; of a status packet without the error byte.
        error: Error byte of a status packet; 0 of any other.
    """

    servo_id: int
    instruction: int
    parameters: bytes = b""
    error: int = 0


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
    """The CRC-16 of some bytes."""
    crc = 0
    for value in data:
        crc = ((crc << 8) & 0xFFFF) ^ _CRC_TABLE[(crc >> 8) ^ value]
    return crc


def packet(servo_id: int, instruction: int, parameters: bytes = b"") -> bytes:
    """The bytes of a packet, stuffed, with length and CRC.

    Raises:
        PacketError: no servo has that id, or there are too many parameters.
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
    """A status packet: what a servo answers."""
    return packet(servo_id, Instruction.STATUS, bytes([error]) + parameters)


def ping(servo_id: int) -> bytes:
    """Asks who is there: model number (2) and firmware version (1) come back."""
    return packet(servo_id, Instruction.PING)


def read(servo_id: int, address: int, size: int) -> bytes:
    """Asks one servo for bytes of its control table."""
    return packet(servo_id, Instruction.READ, _two(address) + _two(size))


def write(servo_id: int, address: int, data: bytes) -> bytes:
    """Writes bytes into one servo's control table; an empty status comes back."""
    return packet(servo_id, Instruction.WRITE, _two(address) + data)


def sync_read(address: int, size: int, servo_ids: Sequence[int]) -> bytes:
    """Asks several servos for the same bytes; they answer one after the other, in this order."""
    return packet(BROADCAST, Instruction.SYNC_READ, _two(address) + _two(size) + bytes(servo_ids))


def sync_write(address: int, data: Mapping[int, bytes]) -> bytes:
    """Writes bytes of one length into the same place of several servos, by id; nothing comes back.

    Raises:
        PacketError: the lengths differ, or there are none.
    """
    sizes = {len(each) for each in data.values()}
    if len(sizes) != 1:
        raise PacketError(
            f"a sync write of {sorted(sizes)} bytes refused: it needs one length for all servos"
        )
    body = b"".join(bytes([servo_id]) + each for servo_id, each in data.items())
    return packet(BROADCAST, Instruction.SYNC_WRITE, _two(address) + _two(sizes.pop()) + body)


def bulk_read(places: Mapping[int, tuple[int, int]]) -> bytes:
    """Asks several servos, by id, for (address, size) each; they answer one by one, in this order."""
    asked = (bytes([servo_id]) + _two(place[0]) + _two(place[1]) for servo_id, place in places.items())
    return packet(BROADCAST, Instruction.BULK_READ, b"".join(asked))


class PacketStream:
    """Finds whole packets in what a port gives: damaged, cut anywhere, or none of this protocol.

    Attributes:
        damaged: Packets given up: wrong CRC or length.
    """

    def __init__(self) -> None:
        self.damaged = 0
        self._data = bytearray()

    def feed(self, data: bytes) -> list[Packet]:
        """Packets that these bytes complete, oldest first; never raises.

        A packet that is damaged is searched for the next header from its second byte on.
        """
        self._data += data
        found: list[Packet] = []
        while (end := self._whole()) is not None:
            taken = _unpacked(bytes(self._data[:end])) if end else None
            if taken is None:
                self.damaged += 1
                del self._data[:1]
            else:
                found.append(taken)
                del self._data[:end]
        return found

    def _whole(self) -> int | None:
        """Length of the packet with which the buffer begins; 0: it is none; None: bytes are missing."""
        start = self._data.find(HEADER)
        if start < 0:  # the end may be the beginning of a header
            kept = next((n for n in (3, 2, 1) if self._data.endswith(HEADER[:n])), 0)
            del self._data[: len(self._data) - kept]
            return None
        del self._data[:start]
        if len(self._data) < _BEFORE_INSTRUCTION:
            return None
        length = int.from_bytes(self._data[5:7], "little")
        if not _LEAST_LENGTH <= length <= _LARGEST_LENGTH or not _is_id(self._data[4]):
            return 0
        end = _BEFORE_INSTRUCTION + length
        if self._data.find(HEADER, len(HEADER), end - 2) >= 0:
            return 0  # stuffing keeps headers out of packets, but for the CRC: this one was cut short
        return end if len(self._data) >= end else None


def _unpacked(data: bytes) -> Packet | None:
    """The packet of these bytes; None where its CRC is wrong, or it is a status without an error byte."""
    if crc16(data[:-2]) != int.from_bytes(data[-2:], "little"):
        return None
    body = data[_BEFORE_INSTRUCTION:-2].replace(_STUFFED, _PATTERN)
    if body[0] != Instruction.STATUS:
        return Packet(data[4], body[0], body[1:])
    return Packet(data[4], body[0], body[2:], body[1]) if len(body) > 1 else None


def _is_id(value: int) -> bool:
    return value <= LARGEST_ID or value == BROADCAST


def _two(number: int) -> bytes:
    return number.to_bytes(2, "little")
