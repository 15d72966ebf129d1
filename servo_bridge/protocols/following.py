"""Whether a board does what it was told, judged by its own telemetry. Pure, no clock."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from servo_bridge.protocols.frames import SEQUENCES, BoardFlags, Telemetry

TOLERANCE_US = 15.0
"""Widths this far in [us] outside of all that was told are another pose: one and a half degrees."""

PATIENCE = 2
"""Telemetry frames in a row that have to contradict; one may have been sent in between."""

DEAF_PATIENCE = 6
"""Telemetry frames in a row without a new acknowledgement, though frames were sent: 0.3 s."""


class Following:
    """Compares each telemetry with the poses told since the board's pose was last taken over.

    Attributes:
        deviation: What the board does instead, for a sentence that begins with "the board"; empty: as told.
    """

    def __init__(self) -> None:
        self.deviation = ""
        self._told: deque[tuple[int, tuple[int, ...]]] = deque(maxlen=SEQUENCES - 1)
        self._sent = 0  # frames since the last telemetry
        self._acknowledged: int | None = None
        self._contradictions = self._deaf = 0

    def begin(self) -> None:
        """The board's pose is taken over: what it was told before does not count."""
        self.deviation = ""
        self._told.clear()
        self._contradictions = self._deaf = 0

    def sent(self) -> None:
        """A frame was sent."""
        self._sent += 1

    def told(self, seq: int, widths_us: Sequence[int]) -> None:
        """A pose was sent, in the frame of that number."""
        self._told.append((seq, tuple(widths_us)))

    def hear(self, telemetry: Telemetry) -> None:
        """Judge a telemetry frame."""
        if telemetry.seq != self._acknowledged:
            self._deaf = 0
        elif self._sent and self._told and telemetry.seq != self._told[-1][0]:
            self._deaf += 1
        self._acknowledged, self._sent = telemetry.seq, 0
        contradiction = self._contradiction(telemetry)
        self._contradictions = self._contradictions + 1 if contradiction else 0
        if self._deaf >= DEAF_PATIENCE:
            self.deviation = "acknowledges nothing of what it is told; check the cable"
        elif self._contradictions >= PATIENCE:
            self.deviation = contradiction

    def _contradiction(self, telemetry: Telemetry) -> str:
        """What the telemetry says other than the poses up to the one that it acknowledges."""
        numbers = [seq for seq, _ in self._told]
        if telemetry.seq not in numbers:
            return ""  # no pose of this time has arrived yet
        flags = telemetry.flags
        if BoardFlags.ACTIVE not in flags:
            return "has no pulses"
        if BoardFlags.LIMITS_SET not in flags:
            return "has forgotten its servos' ranges"
        if BoardFlags.HOMING in flags:
            return "goes to its rest pose by itself"
        if BoardFlags.HOLD in flags or BoardFlags.LINK not in flags:
            return "holds by itself"
        poses = [widths for _, widths in self._told][: numbers.index(telemetry.seq) + 1]
        for width, told in zip(telemetry.widths_us, zip(*poses, strict=True), strict=True):
            if not min(told) - TOLERANCE_US <= width <= max(told) + TOLERANCE_US:
                return f"stands at {' '.join(map(str, telemetry.widths_us))} us, where it was not sent"
        return ""
