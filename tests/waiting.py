"""Waiting for conditions, in the tests across processes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

DEADLINE_S = 120.0
"""Longest wait in [s]; the machine may be busy."""

BUILD_S = 300.0
"""Longest wait in [s] for a robot that starts: its kernels may have to be compiled, on a busy machine."""


def spin_until(condition: Callable[[], Any], deadline_s: float = DEADLINE_S) -> bool:
    """Look at a condition until it holds; False when the deadline passed first."""
    end = time.monotonic() + deadline_s
    while not condition():
        if time.monotonic() > end:
            return False
        threading.Event().wait(0.005)
    return True
