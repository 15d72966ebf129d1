"""Taking over a board's pose: it is asked for before any pose is sent, and compared with the assumed one."""

from __future__ import annotations

import math
import threading
from collections import deque

from servo_bridge.driver.link import BoardLink
from servo_bridge.driver.safety import ServoMotion
from servo_bridge.protocols import Ability, BoardProtocol
from softsim_core.physics.mechanics.limits import check_command

NEWS_KEPT = 20
"""Sentences kept for whoever reports them; older ones are forgotten."""


class Takeover:
    """From the moment at which the board's pose is no longer known to the moment at which it is again.

    A board that takes the servos' ranges is told them, again and again, until it says that it has taken them:
    what it says of its pose from then on is newer than the question. Any other board has answered at once.

    Attributes:
        pending: Whether the board has still to answer.
        reason: Why the pose has to be taken over, a sentence; empty for an ordinary start.
        count: Takeovers with a reason, in total.
        news: Sentences about them, oldest first; whoever reports them takes them out.
    """

    def __init__(self) -> None:
        self.pending = False
        self.reason = ""
        self.count = 0
        self.news: deque[str] = deque(maxlen=NEWS_KEPT)
        self._asked = False

    def begin(self, reason: str = "") -> None:
        """The board's pose is not known any more."""
        self.pending, self._asked = True, False
        self.reason = reason
        if reason:
            self.count += 1
            self.news.append(f"{reason}; the bridge goes on from where the board stands")

    def ask(self, board: BoardProtocol) -> bytes:
        """The packet to write; empty once the board has answered."""
        if not self._asked:
            self._asked = True
            board.begin_takeover()
        elif board.acknowledged():
            return self._end()
        packet = board.limits() if Ability.LIMITS in board.abilities else b""
        return packet or self._end()

    def _end(self) -> bytes:
        self.pending, self.reason = False, ""
        return b""


STALL_S = 0.4
"""Longer without a tick in [s], and the bridge stood still: a board of ours holds after 0.5 s by itself."""

SAME_POSE = math.radians(1.5)
"""Poses of board and bridge nearer than this in [rad] are one: a hobby servo's dead band."""


class BoardPose:
    """What has happened since the board's pose was last known, and how it becomes known again.

    Args:
        motion: Goes on from the pose that is taken over.
        lock: Held while the motion is changed, and never while the board is spoken to, which may hang.

    Attributes:
        moved: Whether the board was told a pose since its port was opened.
        takeover: Whether and why its pose has to be asked for before a pose is sent.
    """

    def __init__(self, motion: ServoMotion, lock: threading.RLock) -> None:
        self.moved = False
        self.takeover = Takeover()
        self._motion, self._lock = motion, lock
        self._held = False  # told to hold, and no pose since
        self._last_tick: float | None = None

    def opened(self) -> None:
        """A port was opened: nothing is known of the board behind it."""
        self.moved = self._held = False
        self.begin()

    def begin(self) -> None:
        """Sending begins: the time before does not count as a stall."""
        self._last_tick = None
        self.takeover.begin()

    def held(self) -> None:
        """The board was told to hold."""
        self._held = True

    def passed_s(self, now: float) -> float:
        """Time in [s] since the tick before, 0 for the first."""
        before, self._last_tick = self._last_tick, now
        return 0.0 if before is None else now - before

    def look(self, link: BoardLink, now: float, stalled_s: float, *, restarted: bool, listens: bool) -> None:
        """Whether something has happened after which the pose has to be asked for.

        Args:
            link: The conversation with the board.
            now: The time in [s].
            stalled_s: Time in [s] since the tick before.
            restarted: The board says that it has started.
            listens: No pose is to be sent.

        Raises:
            PortError: the protocol failed.
        """
        if restarted:
            self._lose("the board has started" if self.moved else "", now)
        elif self._held:
            self._held = False
            self.takeover.begin()
        elif not listens and stalled_s > STALL_S:
            self._lose(f"the bridge stood still for {stalled_s:.1f} s", now)
        elif not listens and not self.takeover.pending:
            with link.speaking() as board:
                deviation = board.deviation()
            if deviation:
                self._lose(f"the board {deviation}", now)

    def question(self, link: BoardLink) -> bytes:
        """The packet that asks the board where it stands; empty where that is known.

        Raises:
            PortError: the protocol failed.
        """
        if not self.takeover.pending:
            return b""
        with link.speaking() as board:
            packet = self.takeover.ask(board)
            if not packet:
                self._take(board)
            return packet

    def _lose(self, reason: str, now: float) -> None:
        with self._lock:
            self._motion.forget(now)
            self.takeover.begin(reason)

    def _take(self, board: BoardProtocol) -> None:
        """Go on from the pose that the board says it has; where it says none, from the last one sent."""
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
            self.takeover.news.append(
                f"the board stands {math.degrees(away):.0f} deg away from what it was told; the bridge goes"
                f" on from there ({degrees} deg)"
            )
