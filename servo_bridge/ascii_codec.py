"""The text protocol of boards with an IMU, 57600 baud: servo bytes out, two tilts in. Pure functions, no I/O.

    to the board:    n0 n1 n2 LF         whole degrees of the servos, 60..180, in text
    from the board:  a,b, CR LF          degrees: rotations about the horizontal axes, a line for each packet

The first angle turns about our y axis and the second about our x axis (x and z of a frame with y up). Such
boards say a few lines of text when they start; whatever is no line of two angles is passed over.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from servo_bridge.codec import BYTE_HIGH, BYTE_LOW
from servo_bridge.errors import PacketError

ASCII_BAUD_RATE = 57600
"""Bits a second of boards that speak this protocol."""

LONGEST_LINE = 80
"""Characters after which a line without end is given up."""

_NUMBER = rb"[+-]?(?:\d{1,4}(?:\.\d{0,8})?|\.\d{1,8})"
_LINE = re.compile(rb"\s*(" + _NUMBER + rb")\s*,\s*(" + _NUMBER + rb")\s*,[^,]*\Z")


@dataclass(frozen=True, slots=True)
class TiltReading:
    """Tilts that an IMU measures, in [rad].

    Attributes:
        tilt_x: Rotation about x: the second number of a line.
        tilt_y: Rotation about y: the first number of a line.
    """

    tilt_x: float
    tilt_y: float

    def quaternion_xyzw(self) -> tuple[float, float, float, float]:
        """Orientation Rx(tilt_x) Ry(tilt_y); the heading, which is not measured, is 0."""
        sin_x, cos_x = math.sin(self.tilt_x / 2.0), math.cos(self.tilt_x / 2.0)
        sin_y, cos_y = math.sin(self.tilt_y / 2.0), math.cos(self.tilt_y / 2.0)
        return (sin_x * cos_y, cos_x * sin_y, sin_x * sin_y, cos_x * cos_y)


def encode_line(servo_bytes: Sequence[int]) -> bytes:
    """The line for servo bytes: `n0 n1 n2` and a line feed.

    Raises:
        PacketError: a byte lies outside 60..180.
    """
    for value in servo_bytes:
        if not BYTE_LOW <= value <= BYTE_HIGH:
            raise PacketError(f"servo byte {value} refused: allowed are {BYTE_LOW}..{BYTE_HIGH}")
    return (" ".join(str(int(value)) for value in servo_bytes) + "\n").encode("ascii")


def parse_line(line: bytes) -> TiltReading | None:
    """The reading of one line without its end; None for any other text, or angles beyond 360 degrees."""
    match = _LINE.match(line)
    if match is None:
        return None
    first, second = (float(number) for number in match.groups())
    if max(abs(first), abs(second)) > 360.0:
        return None
    return TiltReading(tilt_x=math.radians(second), tilt_y=math.radians(first))


@dataclass(slots=True)
class LineParser:
    """Finds lines of two angles in a stream of bytes.

    A line counts only when its beginning was seen: what stands before the first line end may be cut.

    Attributes:
        accepted: Readings so far.
        ignored: Other lines so far.
    """

    accepted: int = 0
    ignored: int = 0
    _line: bytearray | None = field(default=None, repr=False)

    def reset(self) -> None:
        """Forget a line begun; the counters stay."""
        self._line = None

    def feed(self, data: bytes) -> list[TiltReading]:
        """Readings of the lines that these bytes complete, oldest first; never raises."""
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
