"""The threads that help this process with large matrices: a few, kept, asleep until they are asked.

A forked process has none of its parent's threads: it gets its own when it first asks for help. They are
sent home when the interpreter ends.
"""

from __future__ import annotations

import atexit
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from queue import SimpleQueue
from threading import Lock, Thread
from typing import Any

from softsim_core.kernels import OneSignature
from softsim_core.linalg.agenda import close_agenda, open_agenda

VARIABLE = "OMP_NUM_THREADS"
"""Environment variable of the threads of a process, as numeric libraries understand it."""

MOST_THREADS = 8
"""Chosen at most where nobody says a number: beyond, memory is the limit."""


def usable_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def usable_threads() -> int:
    """Threads of this process where a scene names no number: OMP_NUM_THREADS, or the cores it may use."""
    named = os.environ.get(VARIABLE, "").split(",")[0].strip()
    if named.isascii() and named.isdigit() and int(named) > 0:
        return int(named)
    return min(usable_cores(), MOST_THREADS)


class Crew:
    """Threads that carry out calls; it may be asked from any thread.

    Attributes:
        resting: Nobody is asked.
    """

    def __init__(self) -> None:
        self._threads: list[Thread] = []
        self._calls: SimpleQueue[Callable[[], object] | None] = SimpleQueue()
        self._hiring = Lock()
        self.resting = False

    def ask(self, helpers: int, call: Callable[[], object]) -> None:
        """Have so many threads make a call, as soon as they can; nobody waits for them."""
        if self.resting:
            return
        if len(self._threads) < helpers:
            with self._hiring:
                while len(self._threads) < helpers:
                    name = f"softsim helper {len(self._threads) + 1}"
                    thread = Thread(target=self._serve, args=(self._calls,), name=name, daemon=True)
                    thread.start()
                    self._threads.append(thread)
        for _ in range(min(helpers, 2 * len(self._threads) - self._calls.qsize())):  # no pile of late calls
            self._calls.put(call)

    def leave(self) -> None:
        """End all threads; the next one who asks gets new ones."""
        with self._hiring:
            threads, self._threads = self._threads, []
            for _ in threads:
                self._calls.put(None)
            for thread in threads:
                thread.join()

    def forget(self) -> None:
        """Of a process that was forked: the threads are its parent's."""
        self.__init__()  # type: ignore[misc]

    @staticmethod
    def _serve(calls: SimpleQueue[Callable[[], object] | None]) -> None:
        while (call := calls.get()) is not None:
            call()


_crew = Crew()
atexit.register(_crew.leave)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_crew.forget)


@contextmanager
def alone() -> Iterator[None]:
    """No thread gets help meanwhile, so that one can measure what help is worth."""
    before, _crew.resting = _crew.resting, True
    try:
        yield
    finally:
        _crew.resting = before


class Teamwork:
    """A piece of work that one thread leads and others support.

    Args:
        threads: All of them, >= 1.
        lead, support: Kernels of the same arguments, of which the agenda is the last; it says who does what.
    """

    def __init__(self, threads: int, lead: Callable[..., Any], support: Callable[..., Any]) -> None:
        self._helpers = threads - 1
        self._lead, self._support = OneSignature(lead), OneSignature(support)
        self._compiled = False

    def __call__(self, *arguments: Any) -> Any:
        """What `lead` returns. A helper that comes late finds the agenda closed."""
        agenda = open_agenda()
        if self._helpers and not self._compiled:  # not in a helper, while the leader does all the work
            nothing_to_do = open_agenda()
            close_agenda(nothing_to_do)
            self._support(*arguments, nothing_to_do)
            self._compiled = True
        try:
            if self._helpers:
                _crew.ask(self._helpers, partial(self._support, *arguments, agenda))
            return self._lead(*arguments, agenda)
        finally:
            close_agenda(agenda)
