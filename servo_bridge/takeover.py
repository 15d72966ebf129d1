"""Taking over a board's pose: the board is asked, and no pose is sent before it has answered. No I/O."""

from __future__ import annotations

from collections import deque

from servo_bridge.protocols import Ability, BoardProtocol

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
