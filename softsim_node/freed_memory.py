"""What a program does with memory that its arrays leave."""

from __future__ import annotations

import ctypes
from typing import Final

_TRIM_THRESHOLD: Final = -1
_MMAP_THRESHOLD: Final = -3
"""Names of settings in glibc's malloc.h."""

KEPT_BYTES: Final = 1 << 28
LARGEST_BYTES: Final = 1 << 25
"""So much is kept at most, and of arrays no larger than this (more is not allowed)."""


def keep_freed_memory() -> bool:
    """Keep what is freed for the next arrays instead of giving it back to the system; False: no glibc here.

    A step in NumPy frees and asks for the same arrays, a few hundred kilobytes each. Given back, each comes
    in pages that the system fills with zeros: a fifth of the step's time. It holds for the whole process, so
    the simulator asks for it, not the library.
    """
    try:
        set_option = ctypes.CDLL(None).mallopt
    except (OSError, TypeError, AttributeError):
        return False
    return bool(set_option(_TRIM_THRESHOLD, KEPT_BYTES)) and bool(set_option(_MMAP_THRESHOLD, LARGEST_BYTES))
