"""A pseudo-terminal with a board behind it: common base of the virtual and the emulated board.

The bridge opens it with real pyserial on a real tty. How the port behaves, and why:

* The slave end is set to raw mode and closed at once. From then on a hang-up on the master means that no
  program has the port open, and the end of the hang-up means that one opened it: on a real board DTR resets
  it then.
* A stable name is a symbolic link that is replaced atomically. Unplugging removes it and closes the master;
  plugging in again is a power-on behind a new port under the same link.
* A thread serves the port; it ends when the cable is pulled.
"""

from __future__ import annotations

import contextlib
import os
import select
import threading
import tty
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from servo_bridge import PortError

Board = TypeVar("Board", bound="PtyBoard")


class MasterEnd:
    """The board's end of a new pseudo-terminal.

    Attributes:
        device: Name of the other end, which programs open.
    """

    def __init__(self) -> None:
        self._master, slave = os.openpty()
        try:
            tty.setraw(slave)
            self.device = os.ttyname(slave)
        except BaseException:
            os.close(self._master)
            raise
        finally:
            os.close(slave)
        os.set_blocking(self._master, False)
        self._awake, self._wake = os.pipe()
        self._line, self._pause = select.poll(), select.poll()
        self._line.register(self._master, select.POLLIN)
        for each in (self._line, self._pause):
            each.register(self._awake, select.POLLIN)

    def receive(self, patience_s: float | None) -> tuple[bytes, bool] | None:
        """Wait at most `patience_s` seconds for bytes or a hang-up.

        Returns:
            The bytes, and whether some program has the port open; None once the cable is pulled.
        """
        events = dict(self._line.poll(None if patience_s is None else patience_s * 1000.0))
        if self._awake in events:
            return None
        state = events.get(self._master, 0)
        data = b""
        if state & select.POLLIN:
            with contextlib.suppress(OSError):  # no program has it open any more, which the hang-up shows
                data = os.read(self._master, 4096)
        return data, not state & select.POLLHUP

    def pause(self, seconds: float) -> bool:
        """Wait without listening; return True once the cable is pulled."""
        return bool(self._pause.poll(seconds * 1000.0))

    def write(self, data: bytes) -> None:
        """Send bytes; what a full or closed line does not take is lost, as on a wire."""
        with contextlib.suppress(OSError):
            os.write(self._master, data)

    def wake(self) -> None:
        """End `receive` and `pause`, now and from now on."""
        os.write(self._wake, b"x")

    def close(self) -> None:
        """Close the port, also while a program has it open."""
        for each in (self._master, self._awake, self._wake):
            os.close(each)


class PtyBoard(ABC):
    """A board behind a pseudo-terminal; use it as a context manager.

    A subclass calls `replug` when it is ready.

    Args:
        link: Path of a symbolic link to the port, replaced at once when the port changes; None for none.

    Attributes:
        is_open: Whether some program has the port open.
        open_count: Number of times that the port was opened; each one resets a real board.
        received: Number of bytes received from the computer so far, valid or not.
    """

    def __init__(self, link: Path | str | None) -> None:
        self.link = None if link is None else Path(link)
        self._changed = threading.Condition()  # guards and announces every change of state
        self.is_open = False
        self.open_count = self.received = 0
        self._end: MasterEnd | None = None
        self._thread: threading.Thread | None = None

    @abstractmethod
    def _serve(self, end: MasterEnd) -> None:
        """Serve the port in a thread until the cable is pulled."""

    @abstractmethod
    def _power_on(self) -> None:
        """React to the plugged-in cable; called with the lock acquired, before the port can be opened."""

    @abstractmethod
    def _power_off(self) -> None:
        """React to the pulled cable; called with the lock acquired."""

    @property
    def port(self) -> str:
        """Name to open: the link if there is one, else the pseudo-terminal (empty while unplugged)."""
        if self.link is not None:
            return str(self.link)
        end = self._end
        return "" if end is None else end.device

    def wait_for(self: Board, predicate: Callable[[Board], bool], deadline_s: float = 120.0) -> bool:
        """Wait until `predicate(board)` holds; it is evaluated after every change of the board.

        Returns:
            False if `deadline_s` seconds passed first.
        """
        with self._changed:
            return self._changed.wait_for(lambda: predicate(self), timeout=deadline_s)

    def unplug(self) -> None:
        """Pull the cable: the port vanishes even while a program has it open. The servos lose power."""
        if self._end is None:
            return
        self._end.wake()
        if self._thread is not None:
            self._thread.join()
        self._end.close()
        if self.link is not None and self.link.is_symlink() and str(self.link.readlink()) == self._end.device:
            self.link.unlink()
        with self._changed:
            self._end, self.is_open = None, False
            self._power_off()
            self._changed.notify_all()

    def replug(self) -> None:
        """Plug the cable in: a power-on behind a new port (usually with another number) and the same link.

        Raises:
            PortError: the link cannot be created, or its path exists and is no link.
        """
        if self._end is not None:
            return
        end = MasterEnd()
        try:
            make_link(self.link, end.device)
        except BaseException:
            end.close()
            raise
        with self._changed:
            self._power_on()
            self._end = end
        self._thread = threading.Thread(
            target=self._serve, args=(end,), name=type(self).__name__, daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """Remove the port and its link; a second call does nothing."""
        self.unplug()

    def __enter__(self: Board) -> Board:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def make_link(link: Path | None, device: str) -> None:
    """Point `link` to `device` in one atomic step; do nothing if it is None.

    Raises:
        PortError: the link cannot be created, or its path exists and is no link.
    """
    if link is None:
        return
    if link.exists() and not link.is_symlink():
        raise PortError(str(link), f"{link} exists and is no link; give another path for the link")
    fresh = link.with_name(f".{link.name}.{os.getpid()}")
    try:
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(device)
        fresh.replace(link)
    except OSError as error:
        raise PortError(
            str(link), f"link {link} cannot be made ({error.strerror}); give another path"
        ) from error
