"""Long work of a callback in a thread of its own: the executor serves everybody else meanwhile."""

from __future__ import annotations

import threading
from collections.abc import Callable, Generator
from concurrent.futures import Future
from typing import TypeVar

from softsim_core.errors import SoftSimError

LOOK_S = 0.02
"""A look at whether the work is done blocks the executor for at most this long, in [s]."""

Result = TypeVar("Result")


class Aside:
    """One piece of work at a time; to be awaited in a callback that is a coroutine.

    Args:
        what: What is being done, for the refusal of a second piece, such as "a scene is being loaded".
    """

    def __init__(self, what: str) -> None:
        self._what = what
        self._thread: threading.Thread | None = None

    @property
    def is_busy(self) -> bool:
        """Whether work is being done."""
        return self._thread is not None

    async def run(self, work: Callable[[], Result]) -> Result:
        """The result of `work`; what it raises is raised here.

        Raises:
            SoftSimError: other work is being done.
        """
        if self._thread is not None:
            raise SoftSimError(f"{self._what}; ask again once that is done")
        done: Future[Result] = Future()

        def carry_out() -> None:
            try:
                done.set_result(work())
            except BaseException as error:
                done.set_exception(error)

        self._thread = threading.Thread(target=carry_out, name="aside")
        self._thread.start()
        try:
            while self._thread.is_alive():
                self._thread.join(LOOK_S)
                await _Turn()
        finally:
            self._thread = None
        return done.result()

    def close(self) -> None:
        """Wait for the end of the work that is being done, if there is any."""
        thread = self._thread
        if thread is not None:
            thread.join()


class _Turn:
    """Awaited, it lets the executor serve somebody else."""

    def __await__(self) -> Generator[None, None, None]:
        yield
