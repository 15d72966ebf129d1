"""Long work of a callback in a thread of its own: the executor serves everybody else meanwhile."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Generator
from concurrent.futures import Future
from typing import TypeVar

from softsim_core.errors import SoftSimError
from softsim_node.ending import ending

MOST_WAITING = 3
"""So many pieces of work wait for the one that is being done; more are refused."""

LOOK_S = 0.02
"""A look at whether the work is done blocks the executor for at most this long, in [s]."""

Result = TypeVar("Result")


class Aside:
    """One piece of work after the other; to be awaited in a callback that is a coroutine.

    Args:
        what: What is being done, for the refusal of too many pieces, such as "a scene is being loaded".
    """

    def __init__(self, what: str) -> None:
        self._what = what
        self._line: deque[object] = deque()
        self._thread: threading.Thread | None = None

    @property
    def is_busy(self) -> bool:
        """Whether work is being done."""
        return bool(self._line)

    async def run(self, work: Callable[[], Result]) -> Result:
        """The result of `work`, done once all that was asked for before is; what it raises is raised here.

        Raises:
            SoftSimError: too much is waiting already.
        """
        if len(self._line) > MOST_WAITING:
            raise SoftSimError(f"{self._what}, and {MOST_WAITING} more wait; ask again later")
        place = object()
        self._line.append(place)
        try:
            while self._line[0] is not place:
                await self._look()
            return await self._done(work)
        finally:
            self._line.remove(place)

    def close(self) -> None:
        """Wait for the end of the work that is being done, if there is any; see `ending.wait_for`."""
        thread = self._thread
        if thread is not None:
            ending.wait_for(thread)

    async def _done(self, work: Callable[[], Result]) -> Result:
        done: Future[Result] = Future()

        def carry_out() -> None:
            try:
                done.set_result(work())
            except BaseException as error:
                done.set_exception(error)

        self._thread = threading.Thread(target=carry_out, name="aside", daemon=True)
        self._thread.start()
        while self._thread.is_alive():
            await self._look()
        return done.result()

    async def _look(self) -> None:
        if self._thread is not None:
            self._thread.join(LOOK_S)
        await _Turn()


class _Turn:
    """Awaited, it lets the executor serve somebody else."""

    def __await__(self) -> Generator[None, None, None]:
        yield
