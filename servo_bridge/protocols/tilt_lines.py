"""Lines of text with two tilts, as boards with an IMU send them: a,b, CR LF. Pure functions, no I/O.

The numbers are degrees: the first turns about our y axis and the second about our x axis (x and z of a frame
with y up). Such boards say a few lines of text when they start; whatever is no line of two angles is passed
over. A board of another protocol may send such lines as well.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from servo_bridge.protocols.protocol import TiltReading

LONGEST_LINE = 80
"""Characters after which a line without end is given up."""

_NUMBER = rb"[+-]?(?:\d{1,4}(?:\.\d{0,8})?|\.\d{1,8})"
_LINE = re.compile(rb"\s*(" + _NUMBER + rb")\s*,\s*(" + _NUMBER + rb")\s*,[^,]*\Z")


def text_of(data: bytes) -> bytes:
    """The bytes that can be text, without those of frames among them."""
    return bytes(value for value in data if value < 0x80)


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

    def values(self) -> Mapping[str, object]:
        """Count of other lines for /diagnostics; nothing before the first reading."""
        return {"lines ignored": self.ignored} if self.accepted else {}

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
