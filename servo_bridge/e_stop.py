"""The latch of the software e-stop: a flag outside every lock, which the writer looks at for each packet."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable


class EStop:
    """A latch that any thread sets and clears without waiting for anybody.

    Args:
        hurry: Called at each latching: the packet that carries it shall leave at once.

    Attributes:
        count: Times that it was latched: who missed a latching and its clearing sees it here.
    """

    def __init__(self, hurry: Callable[[], None] = lambda: None) -> None:
        self.count = 0
        self._hurry = hurry
        self._numbers = itertools.count(1)
        self._latched, self._heeded = threading.Event(), threading.Event()

    @property
    def latched(self) -> bool:
        """Whether nothing may move."""
        return self._latched.is_set()

    def latch(self) -> None:
        """Stop every servo with a packet that leaves at once, until `clear`."""
        self._heeded.clear()
        self.count = next(self._numbers)
        self._latched.set()
        self._hurry()

    def heed(self) -> None:
        """Whoever writes packets has told the board, or has nothing to tell it."""
        self._heeded.set()

    def wait_heeded(self, timeout_s: float) -> bool:
        """Wait until the packet after `latch` has left; False where nobody writes packets for so long."""
        return self._heeded.wait(timeout_s)

    def clear(self) -> None:
        """Allow motion again; nothing moves before the next command."""
        self._latched.clear()
