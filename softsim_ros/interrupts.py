"""Ctrl-C while kernels are compiled: an end in order, not a traceback from inside the compiler."""

from __future__ import annotations

import _thread
import signal
import threading
from types import FrameType

AGAIN_S = 0.05
"""How long an interrupt inside a callback of the compiler is put off, in [s]."""

_COMPILER = "llvmlite.binding."


def put_off_in_callbacks() -> None:
    """From now on Ctrl-C raises no KeyboardInterrupt inside a callback of the compiler, but right after it.

    An exception cannot leave such a callback: Python prints it, the interrupt is lost and the compiler goes
    on without its object code. A handler other than Python's own stays; only the main thread can set one.
    """
    own = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if own and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, _interrupt)


def _interrupt(number: int, frame: FrameType | None) -> None:
    if not _in_callback(frame):
        signal.default_int_handler(number, frame)
    again = threading.Timer(AGAIN_S, _thread.interrupt_main)
    again.daemon = True
    again.start()


def _in_callback(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_name.startswith("_raw_") and frame.f_globals["__name__"].startswith(_COMPILER):
            return True
        frame = frame.f_back
    return False
