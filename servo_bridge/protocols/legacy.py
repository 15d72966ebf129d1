"""The legacy packet: header 255, then one degree byte per servo (see `servo`); the board sends nothing.

The header always begins a new packet. The board drops a packet with a byte outside 60..180 or older than 40
ms, and stays at its last pose when no packets arrive.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from servo_bridge.driver import angles_to_bytes, bytes_to_angles
from servo_bridge.protocols.ascii_imu import BYTE_HIGH, BYTE_LOW, LineParser, text_of
from servo_bridge.protocols.protocol import BoardModel, BoardProtocol, Decoded, EncodedPacket
from softsim_core.scene import BoardDescription, Servo, ServoCalibration

HEADER = 255  # first byte of a packet; servo bytes never reach it
PARTIAL_TIMEOUT_S = 0.040  # age in [s] at which the board drops a packet that is not complete
# 0x64, "program a page" of the boot loader: received first after a reset it erases the firmware's start
BOOT_LOADER_BYTE = 100


class LegacyProtocol(BoardProtocol):
    """Degree bytes behind a header, to a board that only receives; lines of tilts from it are parsed."""

    name = "legacy"

    def __init__(self, board: BoardDescription) -> None:
        super().__init__(board)
        self._lines = LineParser()

    @classmethod
    def board_model(cls, servos: Sequence[Servo]) -> BoardModel:
        """Return a model of a board that takes legacy packets."""
        return LegacyBoard(len(servos))

    def encode_pose(self, angles_rad: Sequence[float]) -> EncodedPacket:
        """Encode header and degree bytes; a byte 100 becomes 101 unless that is switched off."""
        packet = encode_packet(angles_rad, self.servos, self.board.header)
        sent = avoid_byte_100(packet, self.servos) if self.avoid_byte_100 else packet
        servo_bytes = tuple(sent[1:])
        return EncodedPacket(sent, servo_bytes, bytes_to_angles(servo_bytes, self.servos), sent != packet)

    def decode(self, data: bytes) -> Decoded:
        """Return the tilts of whole lines, if any; they do not distinguish this board from others."""
        return Decoded(tilts=tuple(self._lines.feed(text_of(data))))

    def values(self) -> Mapping[str, object]:
        """Return the number of other lines, if the board has sent tilts."""
        return self._lines.values()


def encode_packet(
    angles_rad: Sequence[float], servos: Sequence[ServoCalibration], header: int = HEADER
) -> bytes:
    """Encode joint angles in [rad], one per servo in packet order: header, then their degree bytes.

    Raises:
        CommandError: wrong number of angles, or one that is not finite; nothing is encoded.
    """
    return bytes([header, *angles_to_bytes(angles_rad, servos)])


def avoid_byte_100(packet: bytes, servos: Sequence[ServoCalibration]) -> bytes:
    """Replace every servo byte 100 by 101, or by 99 for a servo whose range ends at 100.

    A board that is reset in the middle of a packet runs its boot loader first. If the first byte it receives
    then is 100, the boot loader erases the start of the firmware, and the board is dead until the next
    upload. One degree is the dead band of a hobby servo, so no accuracy is lost.
    """
    if BOOT_LOADER_BYTE not in packet[1:]:
        return packet
    above = BOOT_LOADER_BYTE + 1
    below = BOOT_LOADER_BYTE - 1
    return packet[:1] + bytes(
        value if value != BOOT_LOADER_BYTE else (above if servo.byte_max >= above else below)
        for value, servo in zip(packet[1:], servos, strict=True)
    )


@dataclass(slots=True)
class PacketParser:
    """Parser of the board's side of the protocol, byte by byte, on a clock that is passed in.

    The header always starts a new packet. A byte outside 60..180 drops the packet, and so does an age of 40
    ms.
    """

    servo_count: int = 3  # servo bytes in a packet
    header: int = HEADER  # first byte of a packet
    accepted: int = 0  # packets accepted so far
    dropped: int = 0  # packets dropped so far (cut short by a new header, out of range, or too old)
    _partial: bytearray | None = field(default=None, repr=False)
    _started: float = field(default=0.0, repr=False)

    def reset(self) -> None:
        """Drop an unfinished packet, as a reset of the board does; the counters stay."""
        self._partial = None

    def drop_older(self, now: float, age_s: float) -> None:
        """Drop a packet that began more than `age_s` seconds before `now`, and count it."""
        if self._partial is not None and now - self._started > age_s:
            self._drop()

    def feed(self, data: bytes, now: float) -> list[tuple[int, ...]]:
        """Return the packets completed by bytes received at `now` in [s] (any steady clock), oldest first."""
        packets = (self._take(value, now) for value in data)
        return [packet for packet in packets if packet is not None]

    def _take(self, value: int, now: float) -> tuple[int, ...] | None:
        self.drop_older(now, PARTIAL_TIMEOUT_S)
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


class LegacyBoard(BoardModel):
    """A board that takes legacy packets and sends nothing."""

    accepted = dropped = 0

    def __init__(self, servo_count: int) -> None:
        self._packets = PacketParser(servo_count)

    def feed(self, data: bytes, now: float) -> list[tuple[int, ...]]:
        """Return the servo bytes of the packets that these bytes complete, oldest first."""
        packets = self._packets.feed(data, now)
        self.accepted, self.dropped = self._packets.accepted, self._packets.dropped
        return packets

    def reset(self, cause: int) -> None:
        """Drop an unfinished packet; the counters stay."""
        self._packets.reset()
