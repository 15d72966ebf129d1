"""When this process shall end: a signal came, or the program that started it is gone; what is left behind."""

from __future__ import annotations

import errno
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
"""Not every system has it."""

END_SIGNALS = (signal.SIGINT, signal.SIGTERM, *([HANG_UP] if HANG_UP is not None else []))
OUTLIVE = "SOFTSIM_OUTLIVE_PARENT"
"""Set to 1, a process goes on when the program that started it ends; so it does when started by nohup."""

AGAIN_S = 0.05
"""How long an interrupt inside a callback of the compiler is put off, in [s]."""

PATIENCE_S = 0.5
"""A process that shall end waits so long for a thread in [s], then leaves it behind: compiling kernels takes
tens of seconds, and nothing can interrupt it."""

LOOK_S = 0.05
"""Who waits for other work looks this often whether the process shall end, in [s]."""

_COMPILER = "llvmlite.binding."

Result = TypeVar("Result")


class Ending:
    """A request to end, looked at between the steps of a loop; inside `interruptible` it comes at once.

    A program has one, `ending`. Signals after the first change nothing: none cuts the way to a safe state
    short.
    """

    def __init__(self) -> None:
        self._asked = self._raised = self._raises = False
        self._parent: int | None = None
        self._left: list[threading.Thread] = []

    def watch(self) -> None:
        """Take SIGINT, SIGTERM and SIGHUP as a request to end from now on, and the end of the parent, too.

        A hang-up that was ignored at the start (nohup) stays so, and the end of the parent with it. Only the
        main thread can; a second call changes nothing.
        """
        if threading.current_thread() is not threading.main_thread():
            return
        stays = HANG_UP is not None and signal.getsignal(HANG_UP) is signal.SIG_IGN
        for number in END_SIGNALS:
            if not (stays and number == HANG_UP):
                signal.signal(number, self._on_signal)
        if self._parent is None and not stays and os.environ.get(OUTLIVE, "0") in ("", "0"):
            self._parent = os.getppid()

    @property
    def asked(self) -> bool:
        """Whether the process shall end."""
        return self._asked or self.is_orphan

    @property
    def is_orphan(self) -> bool:
        """Whether the program that started this one is gone, and this one shall not outlive it."""
        return self._parent not in (None, os.getppid())

    @contextmanager
    def interruptible(self) -> Iterator[None]:
        """The first signal raises KeyboardInterrupt inside: for long work that leaves nothing to be closed.

        Signals come to the main thread; in another one nothing changes.
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
        """No signal raises inside, also where this lies inside `interruptible`."""
        with self._raising(False):
            yield

    def wait_for(self, thread: threading.Thread) -> bool:
        """Join a thread that was told to end; False: the process shall end and left it behind, see `leave`.

        It has to be a daemon that touches nothing that is closed after this.
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
        """The result of work that leaves nothing to be closed; what it raises is raised here.

        In the main thread the work is done in another one, so that a signal is heard while it compiles.

        Raises:
            KeyboardInterrupt: the process shall end; the work is left behind.
        """
        if threading.current_thread() is not threading.main_thread():
            return work()
        done: Future[Result] = Future()

        def carry_out() -> None:
            try:
                done.set_result(work())
            except BaseException as error:
                done.set_exception(error)

        thread = threading.Thread(target=carry_out, name="abandonable", daemon=True)
        try:
            thread.start()
            while not wait((done,), LOOK_S).done:
                if self.asked:
                    raise KeyboardInterrupt
        except KeyboardInterrupt:  # of a signal inside `interruptible`, too
            self._left.append(thread)
            raise
        return done.result()

    def leave(self, code: int) -> int:
        """The process's exit code, as its last step; where a thread was left behind it ends here and now.

        The interpreter would take the compiler's data away from under a thread that compiles.
        """
        if any(thread.is_alive() for thread in self._left):
            for stream in (sys.stdout, sys.stderr):
                with suppress(OSError, ValueError):
                    stream.flush()
            os._exit(code)
        return code

    def over(self) -> None:
        """Everything is closed: a signal on the last steps of the interpreter is ignored.

        What is still written to a terminal that has gone is dropped.
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
"""This process's."""


def leave_lost_terminal() -> None:
    """Let standard streams whose terminal was closed go nowhere: each write would fail, also at the exit."""
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
    """Whether the compiler waits for Python code of this frame.

    An exception cannot leave such a callback: Python prints it, the interrupt is lost and the compiler goes
    on without its object code.
    """
    while frame is not None:
        if frame.f_code.co_name.startswith("_raw_") and frame.f_globals["__name__"].startswith(_COMPILER):
            return True
        frame = frame.f_back
    return False
