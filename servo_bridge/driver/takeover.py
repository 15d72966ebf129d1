"""Takeover of a board's pose: it is queried before any pose is sent, and compared with the assumed one."""

from __future__ import annotations

import math
import threading
from collections import deque

from servo_bridge.driver.link import BoardLink
from servo_bridge.driver.safety import ServoMotion
from servo_bridge.protocols import Ability, BoardProtocol
from softsim_core.physics.mechanics import check_command

MOST_MESSAGES = 20  # messages stored until they are reported; older ones are dropped
# A longer time between ticks in [s] is a stall of the bridge; our firmware holds after 0.5 s by itself
STALL_S = 0.4

# Poses of board and bridge closer than this in [rad] are the same: a hobby servo's dead band
SAME_POSE = math.radians(1.5)


class Takeover:
    """Detects that the board's pose has become unknown, and takes it over.

    A board with the ability LIMITS is sent the servos' ranges repeatedly until it acknowledges them: a pose
    that it reports from then on is newer than the request. Any other board has answered at once.

    Args:
        motion: The motion that continues from the pose that is taken over.
        lock: Acquired while the motion is changed, and never during a call of the protocol, which may hang.

    Attributes:
        moved: Whether a pose was sent to the board since its port was opened.
        hold_sent: Whether the board was commanded to hold, and no pose sent since.
        pending: Whether the board has to be asked for its pose before a pose is sent.
        reason: Message that says why the pose has to be taken over; empty for an ordinary start.
        count: Number of takeovers with a reason.
        news: Messages about them, oldest first; the caller that reports a message removes it.
    """

    def __init__(self, motion: ServoMotion, lock: threading.RLock) -> None:
        self.moved = self.hold_sent = self.pending = False
        self.reason = ""
        self.count = 0
        self.news: deque[str] = deque(maxlen=MOST_MESSAGES)
        self._motion, self._lock = motion, lock
        self._asked = False
        self._last_tick: float | None = None

    def record_opening(self) -> None:
        """Record that a port was opened: the pose of the board behind it is unknown."""
        self.moved = self.hold_sent = False
        self.start()

    def start(self) -> None:
        """Record that sending begins: the time before does not count as a stall."""
        self._last_tick = None
        self._begin()

    def passed_s(self, now: float) -> float:
        """Return the time in [s] since the tick before, 0 for the first."""
        before, self._last_tick = self._last_tick, now
        return 0.0 if before is None else now - before

    def look(self, link: BoardLink, now: float, stalled_s: float, *, restarted: bool, listens: bool) -> None:
        """Check for an event after which the board has to be asked for its pose, and start a takeover then.

        The last tick was `stalled_s` before `now`; `restarted`: the board reports that it has started;
        `listens`: no pose is sent at present.
        """
        if restarted:
            self._lose("the board has started" if self.moved else "", now)
        elif self.hold_sent:
            self.hold_sent = False
            self._begin()
        elif not listens and stalled_s > STALL_S:
            self._lose(f"the bridge was stalled for {stalled_s:.1f} s", now)
        elif not listens and not self.pending:
            with link.speaking() as board:
                deviation = board.deviation()
            if deviation:
                self._lose(f"the board {deviation}", now)

    def question(self, link: BoardLink) -> bytes:
        """Return the packet that asks the board for its pose; empty once the pose is known."""
        if not self.pending:
            return b""
        with link.speaking() as board:
            answered = self._asked and board.acknowledged()
            if not self._asked:
                self._asked = True
                board.begin_takeover()
            packet = b"" if answered or Ability.LIMITS not in board.abilities else board.limits()
            if not packet:
                self.pending, self.reason = False, ""
                self._take(board)
            return packet

    def _begin(self, reason: str = "") -> None:
        self.pending, self._asked = True, False
        self.reason = reason
        if reason:
            self.count += 1
            self.news.append(f"{reason}; the bridge continues from the board's pose")

    def _lose(self, reason: str, now: float) -> None:
        with self._lock:
            self._motion.forget(now)
            self._begin(reason)

    def _take(self, board: BoardProtocol) -> None:
        """Continue from the pose that the board reports; without one, from the last pose sent."""
        self._motion.top_speed = board.top_speed
        pose = board.pose()
        if pose is None:
            return
        with self._lock:
            before = self._motion.positions
            self._motion.resume_from(check_command(pose, self._motion.names))
        away = max(abs(one - other) for one, other in zip(before, self._motion.positions, strict=True))
        if away > SAME_POSE and self.moved:
            degrees = ", ".join(f"{math.degrees(each):.1f}" for each in self._motion.positions)
            self.news.append(
                f"the board is {math.degrees(away):.0f} deg away from its commands; the bridge continues"
                f" from there ({degrees} deg)"
            )
