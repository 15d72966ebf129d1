"""What other threads ask of the one thread that owns an object: done in turn, between its own work."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable
from concurrent.futures import Future, wait
from typing import TypeVar

from softsim_core.errors import SoftSimError
from softsim_node.ending import LOOK_S, ending

REQUEST_TIMEOUT_S = 30.0
"""A request waits this long for the work in progress, in [s]; the first may compile kernels."""

Result = TypeVar("Result")


class WorkQueue:
    """A queue of actions for a thread.

    Args:
        owner: Whose thread it is, for messages, such as "the physics".
        work: What a request waits for, for messages, such as "a physics step".
        is_alive: Whether the thread runs.
    """

    def __init__(self, owner: str, work: str, is_alive: Callable[[], bool]) -> None:
        self._owner, self._work, self._is_alive = owner, work, is_alive
        self._queue: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()

    def ask(self, action: Callable[[], Result]) -> Result:
        """Have the thread run an action and wait for its result; what it raises is raised here.

        What is given up before the thread has begun it is never done.

        Raises:
            SoftSimError: the thread has ended, the process shall end, or the thread is busy for longer than
                REQUEST_TIMEOUT_S.
        """
        future: Future[Result] = Future()

        def run() -> None:
            if not future.set_running_or_notify_cancel():
                return
            try:
                future.set_result(action())
            except BaseException as error:
                future.set_exception(error)

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
        """Have `serve` return False after the requests before this."""
        self._queue.put(None)

    def serve(self, delay_s: float | None, mode: Callable[[], object]) -> bool:
        """In the thread: run what is asked for `delay_s` in [s] (None: without end), or until `mode` changes.

        Returns:
            False: the thread shall end.
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
