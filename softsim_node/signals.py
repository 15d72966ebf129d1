"""The end of this process: requested by a signal, or by the end of the program that started it."""

from __future__ import annotations

import atexit
import errno
import gc
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, wait
from contextlib import contextmanager, suppress
from types import FrameType
from typing import TypeVar

HANG_UP = getattr(signal, "SIGHUP", None)
"""SIGHUP, which not every system has."""

END_SIGNALS = (signal.SIGINT, signal.SIGTERM, *([HANG_UP] if HANG_UP is not None else []))
OUTLIVE = "SOFTSIM_OUTLIVE_PARENT"
"""Set to 1, a process continues when the program that started it ends, as it does when started by nohup."""

AGAIN_S = 0.05
"""Delay in [s] after which an interrupt that arrived inside a callback of the compiler is raised again."""

PATIENCE_S = 0.5
"""Longest wait in [s] for a thread when the process is to end; then the thread is left behind.

Compiling kernels takes tens of seconds, and nothing can interrupt it.
"""

LOOK_S = 0.05
"""Interval in [s] at which a wait for other work checks whether the process is to end."""

_COMPILER = "llvmlite.binding."

Result = TypeVar("Result")


def settle(future: Future[Result], work: Callable[[], Result]) -> None:
    """Do work; its result, or its exception, becomes that of the future."""
    try:
        future.set_result(work())
    except BaseException as error:
        future.set_exception(error)


class Ending:
    """A request to end the process; loops check it between their steps.

    Inside `interruptible` it acts at once. A program has one instance, `ending`. Signals after the first
    change nothing, so that none interrupts the move to a safe state.
    """

    def __init__(self) -> None:
        self._asked = self._raised = self._raises = False
        self._parent: int | None = None
        self._left: list[threading.Thread] = []

    def watch(self) -> None:
        """Treat SIGINT, SIGTERM, SIGHUP and the end of the parent process as a request to end from now on.

        If a hang-up was ignored at the start (nohup), it stays ignored, and so does the end of the parent.
        Only the main thread can install this; a second call changes nothing.
        """
        if threading.current_thread() is not threading.main_thread():
            return
        stays = HANG_UP is not None and signal.getsignal(HANG_UP) is signal.SIG_IGN
        for number in END_SIGNALS:
            if not (stays and number == HANG_UP):
                signal.signal(number, self._on_signal)
        if self._parent is None and not stays and os.environ.get(OUTLIVE, "0") in ("", "0"):
            self._parent = os.getppid()
        atexit.unregister(gc.freeze)
        atexit.register(gc.freeze)  # else the interpreter collects several times as it ends: 0.4 s

    @property
    def asked(self) -> bool:
        """Whether the process is to end."""
        return self._asked or self.is_orphan

    @property
    def is_orphan(self) -> bool:
        """Whether the program that started this one has ended, and this one is not to outlive it."""
        return self._parent not in (None, os.getppid())

    @contextmanager
    def interruptible(self) -> Iterator[None]:
        """Raise KeyboardInterrupt at the first signal inside; for long work without anything to close.

        Signals arrive in the main thread; in another one nothing changes.
        """
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        with self._raising(True):
            if self._asked and not self._raised:
                self._raised = True
                raise KeyboardInterrupt
            yield

    @contextmanager
    def orderly(self) -> Iterator[None]:
        """Raise at no signal inside, also within `interruptible`."""
        with self._raising(False):
            yield

    def wait_for(self, thread: threading.Thread) -> bool:
        """Join a thread that was asked to end; return False if it is left behind, see `leave`.

        The thread is left behind if the process is to end and the thread takes longer than PATIENCE_S. It has
        to be a daemon that uses nothing that is closed afterwards.
        """
        while thread.is_alive():
            thread.join(LOOK_S)
            if self.asked:
                thread.join(PATIENCE_S)
                if thread.is_alive():
                    self._left.append(thread)
                    return False
        return True

    def abandonable(self, work: Callable[[], Result]) -> Result:
        """Return the result of work without anything to close; its exception is raised here.

        In the main thread the work runs in another thread, so that a signal is handled while it compiles.

        Raises:
            KeyboardInterrupt: the process is to end; the work is left behind.
        """
        if threading.current_thread() is not threading.main_thread():
            return work()
        done: Future[Result] = Future()
        thread = threading.Thread(target=settle, args=(done, work), name="abandonable", daemon=True)
        try:
            thread.start()
            while not wait((done,), LOOK_S).done:
                if self.asked:
                    raise KeyboardInterrupt
        except KeyboardInterrupt:  # also that of a signal inside `interruptible`
            self._left.append(thread)
            raise
        return done.result()

    def leave(self, code: int) -> int:
        """Return the exit code as the last step of the process; if a thread was left behind, exit here.

        The interpreter would free the data of the compiler while that thread still compiles.
        """
        if any(thread.is_alive() for thread in self._left):
            for stream in (sys.stdout, sys.stderr):
                with suppress(OSError, ValueError):
                    stream.flush()
            os._exit(code)
        return code

    def over(self) -> None:
        """Ignore signals from now on: everything is closed, and only the end of the interpreter is left.

        Output to a terminal that has gone is dropped.
        """
        if threading.current_thread() is threading.main_thread():
            for number in END_SIGNALS:
                signal.signal(number, signal.SIG_IGN)
        leave_lost_terminal()

    @contextmanager
    def _raising(self, raises: bool) -> Iterator[None]:
        before, self._raises = self._raises, raises
        try:
            yield
        finally:
            self._raises = before

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self._asked = True
        if not self._raises or self._raised:
            return
        if _in_callback(frame):
            again = threading.Timer(AGAIN_S, os.kill, (os.getpid(), number))
            again.daemon = True
            again.start()
            return
        self._raised = True
        raise KeyboardInterrupt


ending = Ending()
"""The instance of this process."""


def leave_lost_terminal() -> None:
    """Redirect standard streams with a closed terminal to nowhere, since each write to them would fail.

    That includes writes at the exit of the process.
    """
    try:
        import termios
    except ImportError:  # no POSIX system
        return
    for stream in (0, 1, 2):
        try:
            termios.tcgetattr(stream)
        except termios.error as error:
            if error.args[0] == errno.EIO:
                nowhere = os.open(os.devnull, os.O_RDWR)
                os.dup2(nowhere, stream)
                os.close(nowhere)


def _in_callback(frame: FrameType | None) -> bool:
    """Return whether the compiler waits for Python code of this frame.

    An exception cannot leave such a callback: Python prints it, the interrupt is lost, and the compiler
    continues without its object code.
    """
    while frame is not None:
        if frame.f_code.co_name.startswith("_raw_") and frame.f_globals["__name__"].startswith(_COMPILER):
            return True
        frame = frame.f_back
    return False
