"""Work for another thread: a queue for the thread that owns an object, and background workers."""

from __future__ import annotations

import functools
import queue
import threading
import time
import types
from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Generator
from concurrent.futures import Future, wait
from typing import Any, Concatenate, ParamSpec, TypeVar

from softsim_core.base import SoftSimError
from softsim_node.signals import LOOK_S, ending, settle

REQUEST_TIMEOUT_S = 30.0
"""Longest wait in [s] of a request for the work in progress; the first one may compile kernels."""

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")


class WorkQueue:
    """A queue of actions for the thread that owns an object.

    Args:
        owner: Owner of the thread, for messages, such as "the physics".
        work: The work that a request waits for, for messages, such as "a physics step".
    """

    def __init__(self, owner: str, work: str, is_alive: Callable[[], bool]) -> None:
        self._owner, self._work, self._is_alive = owner, work, is_alive
        self._queue: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()

    def ask(self, action: Callable[[], Result]) -> Result:
        """Run an action in the thread and wait for its result; its exception is raised here.

        An action that is abandoned before the thread has begun it is never run.

        Raises:
            SoftSimError: the thread has ended, the process is to end, or the thread is busy for longer than
                REQUEST_TIMEOUT_S.
        """
        future: Future[Result] = Future()

        def run() -> None:
            if future.set_running_or_notify_cancel():
                settle(future, action)

        self._queue.put(run)
        end = time.monotonic() + REQUEST_TIMEOUT_S
        while not wait((future,), LOOK_S).done:
            why = ""
            if ending.asked:
                why = "request given up: this program ends"
            elif not self._is_alive():
                why = f"request refused: {self._owner} has ended"
            elif time.monotonic() > end:
                why = f"request given up: {self._work} takes more than {REQUEST_TIMEOUT_S:g} s"
            if why and future.cancel():
                raise SoftSimError(f"{why}; it is not done later")
            if why and future.running():
                raise SoftSimError(f"{why}; it has begun, and may still be done")
        return future.result()

    def ask_to_end(self) -> None:
        """Make `serve` return False after the requests before this one."""
        self._queue.put(None)

    def serve(self, delay_s: float | None, mode: Callable[[], object]) -> bool:
        """Run requested actions for `delay_s` in [s] (None: without end), or until `mode` changes.

        Call this in the thread that owns the object.

        Returns:
            False if the thread is to end.
        """
        due = None if delay_s is None else time.monotonic() + delay_s
        while True:
            left = None if due is None else due - time.monotonic()
            try:
                run = self._queue.get(block=left is None or left > 0.0, timeout=left)
            except queue.Empty:
                return True
            if run is None:
                return False
            before = mode()
            run()
            if mode() != before:
                return True


class OwnerThread(WorkQueue):
    """A daemon thread that owns an object and serves requests between its steps; a subclass has `_run`."""

    def __init__(self, name: str, owner: str, work: str) -> None:
        super().__init__(owner, work, lambda: self.is_alive)
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def close(self) -> bool:
        """Stop after the step in progress and join the thread, see `ending.wait_for`.

        A second call does nothing.
        """
        self.ask_to_end()
        return ending.wait_for(self._thread)

    @property
    def is_alive(self) -> bool:
        """Whether the thread runs."""
        return self._thread.is_alive()

    @abstractmethod
    def _run(self) -> None:
        """Work until `serve` returns False."""


def in_thread(
    method: Callable[Concatenate[Any, Parameters], Result],
) -> Callable[Concatenate[Any, Parameters], Result]:
    """Make a method of an OwnerThread a request, see WorkQueue.ask: it runs in the thread, between steps."""

    @functools.wraps(method)
    def ask(self: Any, /, *args: Parameters.args, **options: Parameters.kwargs) -> Result:
        result: Result = self.ask(functools.partial(method, self, *args, **options))
        return result

    return ask


MOST_WAITING = 3
"""Number of tasks that may wait for the one in progress; more are refused."""

ANSWER_LOOK_S = 0.02
"""Longest time in [s] for which a check of the work in progress blocks the executor."""


class BackgroundWorker:
    """Background worker that runs one task after the other; await it in a callback that is a coroutine.

    Args:
        what: Description of the work for the refusal of too many tasks, such as "a scene is being loaded".
    """

    def __init__(self, what: str) -> None:
        self._what = what
        self._line: deque[object] = deque()
        self._thread: threading.Thread | None = None

    @property
    def is_busy(self) -> bool:
        """Whether a task is in progress."""
        return bool(self._line)

    async def run(self, work: Callable[[], Result]) -> Result:
        """Return the result of `work`, which runs after all earlier tasks; its exception is raised here.

        Raises:
            SoftSimError: too many tasks are waiting already.
        """
        if len(self._line) > MOST_WAITING:
            raise SoftSimError(f"{self._what}, and {MOST_WAITING} more wait; ask again later")
        place = object()
        self._line.append(place)
        try:
            while self._line[0] is not place:
                await self._look()
            done: Future[Result] = Future()
            self._thread = threading.Thread(target=settle, args=(done, work), name="background", daemon=True)
            self._thread.start()
            while self._thread.is_alive():
                await self._look()
            return done.result()
        finally:
            self._line.remove(place)

    def close(self) -> None:
        """Wait for the end of the task in progress, if there is one; see `ending.wait_for`."""
        if self._thread is not None:
            ending.wait_for(self._thread)

    async def _look(self) -> None:
        if self._thread is not None:
            self._thread.join(ANSWER_LOOK_S)
        await _turn()


@types.coroutine
def _turn() -> Generator[None, None, None]:
    """Let the executor run another callback."""
    yield
