"""The text protocol of boards with an IMU, 57600 baud: servo bytes out, two tilts in.

The numbers are degrees: the first is a rotation about our y axis, the second about our x axis (x and z of a
frame with y up). Such boards send a few lines of text when they start; every line but those of two angles is
ignored. A board of another protocol may send such lines, too.

to the board:    n0 n1 n2 LF         whole degrees of the servos, 60..180, in text
from the board:  a,b, CR LF          tilts in degrees, a line for each packet; see LineParser
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from servo_bridge import PacketError
from servo_bridge.driver import angles_to_bytes, bytes_to_angles
from servo_bridge.protocols.protocol import (
    Ability,
    BoardModel,
    BoardProtocol,
    Decoded,
    EncodedPacket,
    TiltReading,
)
from softsim_core.scene import BoardDescription, Servo

LONGEST_LINE = 80  # number of characters after which a line without an end is dropped
_NUMBER = rb"[+-]?(?:\d{1,4}(?:\.\d{0,8})?|\.\d{1,8})"
_LINE = re.compile(rb"\s*(" + _NUMBER + rb")\s*,\s*(" + _NUMBER + rb")\s*,[^,]*\Z")


def text_of(data: bytes) -> bytes:
    """Return the bytes that can be text; drop the bytes of frames."""
    return bytes(value for value in data if value < 0x80)


def parse_line(line: bytes) -> TiltReading | None:
    """Parse one line without its end; return None for any other text, or for angles beyond 360 degrees."""
    match = _LINE.match(line)
    if match is None:
        return None
    first, second = (float(number) for number in match.groups())
    if max(abs(first), abs(second)) > 360.0:
        return None
    return TiltReading(tilt_x=math.radians(second), tilt_y=math.radians(first))


@dataclass(slots=True)
class LineParser:
    """Parser that finds lines of two angles in a stream of bytes.

    A line counts only if its beginning was received: the text before the first line end may be cut.
    """

    accepted: int = 0  # number of readings so far
    ignored: int = 0  # number of other lines so far
    _line: bytearray | None = field(default=None, repr=False)

    def values(self) -> Mapping[str, object]:
        """Return the number of other lines for /diagnostics; empty before the first reading."""
        return {"lines ignored": self.ignored} if self.accepted else {}

    def feed(self, data: bytes) -> list[TiltReading]:
        """Return the readings of the lines that these bytes complete, oldest first; never raises."""
        readings = []
        *ended, rest = re.split(rb"[\r\n]", data)
        for piece in ended:
            reading = self._end(piece)
            if reading is not None:
                readings.append(reading)
            self._line = bytearray()
        self._add(rest)
        return readings

    def _add(self, piece: bytes) -> None:
        if self._line is not None:
            self._line += piece
            if len(self._line) > LONGEST_LINE:
                self.ignored += 1
                self._line = None

    def _end(self, piece: bytes) -> TiltReading | None:
        self._add(piece)
        if self._line is None or not self._line.strip():
            return None
        reading = parse_line(bytes(self._line))
        self.accepted += reading is not None
        self.ignored += reading is None
        return reading


ASCII_BAUD_RATE = 57600  # bits per second of boards that speak this protocol
BYTE_LOW, BYTE_HIGH = 60, 180  # range of servo bytes that such boards accept


class AsciiImuProtocol(BoardProtocol):
    """Lines of servo bytes to a board that responds to each with the tilts of its IMU."""

    name = "ascii_imu"
    abilities = Ability.IMU
    baud_rate = ASCII_BAUD_RATE

    def __init__(self, board: BoardDescription) -> None:
        super().__init__(board)
        self._lines = LineParser()

    @classmethod
    def refusal(cls, board: BoardDescription) -> str:
        """Refuse servos whose range exceeds 60..180."""
        for servo in board.hobby_servos:
            if servo.byte_min < BYTE_LOW or servo.byte_max > BYTE_HIGH:
                return (
                    f"servo {servo.joint}: the text protocol allows bytes {BYTE_LOW}..{BYTE_HIGH}, not"
                    f" {servo.byte_min}..{servo.byte_max}; change the range, or the parameter protocol"
                )
        return ""

    @classmethod
    def board_model(cls, servos: Sequence[Servo]) -> BoardModel:
        """Return a model of a level board."""
        return AsciiImuBoard(len(servos))

    def encode_pose(self, angles_rad: Sequence[float]) -> EncodedPacket:
        """Encode one line; it has digits, blanks and a line feed, and so never a byte 100."""
        servo_bytes = angles_to_bytes(angles_rad, self.servos)
        return EncodedPacket(encode_line(servo_bytes), servo_bytes, bytes_to_angles(servo_bytes, self.servos))

    def decode(self, data: bytes) -> Decoded:
        """Return the tilts of whole lines."""
        return Decoded(tilts=tuple(self._lines.feed(text_of(data))))

    def values(self) -> Mapping[str, object]:
        """Return the number of lines without tilts."""
        return {"lines ignored": self._lines.ignored}


def encode_line(servo_bytes: Sequence[int]) -> bytes:
    """Return the line for servo bytes: `n0 n1 n2` and a line feed.

    Raises:
        PacketError: a byte lies outside 60..180.
    """
    for value in servo_bytes:
        if not BYTE_LOW <= value <= BYTE_HIGH:
            raise PacketError(f"servo byte {value} refused: allowed are {BYTE_LOW}..{BYTE_HIGH}")
    return (" ".join(str(int(value)) for value in servo_bytes) + "\n").encode("ascii")


class AsciiImuBoard(BoardModel):
    """A board that takes lines of `servo_count` servo bytes and responds to each with tilts of 0."""

    accepted = dropped = 0

    def __init__(self, servo_count: int) -> None:
        self._servo_count = servo_count
        self._line = b""
        self._answers = 0

    def feed(self, data: bytes, now: float) -> list[tuple[int, ...]]:
        """Return the servo bytes of the lines that these bytes complete, oldest first."""
        *lines, rest = (self._line + data).split(b"\n")
        self._line = rest[:LONGEST_LINE]
        poses = [pose for pose in map(self._take, lines) if pose is not None]
        self.accepted += len(poses)
        self.dropped += len(lines) - len(poses)
        self._answers += len(poses)
        return poses

    def say(self, now: float) -> bytes:
        """Return one line of tilts for each line accepted since the last call."""
        answers, self._answers = self._answers, 0
        return b"0.0000,0.0000,\r\n" * answers

    def reset(self, cause: int) -> None:
        """Drop an unfinished line; the counters stay."""
        self._line, self._answers = b"", 0

    def _take(self, line: bytes) -> tuple[int, ...] | None:
        if not re.fullmatch(rb"\d{1,3}(?: \d{1,3})*", line):
            return None
        pose = tuple(map(int, line.split()))
        whole = len(pose) == self._servo_count and all(BYTE_LOW <= each <= BYTE_HIGH for each in pose)
        return pose if whole else None
