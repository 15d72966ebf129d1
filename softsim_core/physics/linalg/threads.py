"""Threads that share the work on large matrices: an agenda of tasks, and atomic counters.

The tasks are planned once, independent of the number of threads, and a task has the same result on any
thread. Results are therefore the same bit by bit for any number of threads. The leading thread takes tasks
like all others, and waits only for tasks that another thread has begun: helpers that come late, or never,
delay nothing.

An agenda serves one piece of work and is never reused, so that a late helper finds it closed.

A forked process has none of its parent's threads; it starts its own when it first asks for help. Threads end
with the interpreter.
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

import numpy as np

from softsim_core.base import IndexArray, usable_cores
from softsim_core.physics.kernels import OneSignature
from softsim_core.physics.linalg.compile import kernel
from softsim_core.physics.linalg.instructions import (
    atomic_add,
    atomic_exchange,
    atomic_load,
    atomic_store,
    give_way,
    steady_seconds,
)

_LINE = 8
"""Numbers in a cache line; each thread-written counter has a line of its own."""

_CLAIM, _DONE, _PHASE, _ORDER = 0, _LINE, 2 * _LINE, 3 * _LINE
_BITS = 20
_MOST = (1 << _BITS) - 1
CLOSED, NONE = -2, -1
"""Values instead of a task: there will be no more tasks, and there is none for now."""

PATIENCE_S = 0.05
"""Time in [s] after which a helper without a task leaves."""


def open_agenda() -> IndexArray:
    """Return an agenda without tasks."""
    return np.zeros(4 * _LINE, np.int64)


def close_agenda(agenda: IndexArray) -> None:
    """Close an agenda, so that all helpers leave."""
    agenda[_CLAIM] = CLOSED


@kernel
def publish(agenda: IndexArray, kind: int, subject: int, detail: int, count: int) -> None:
    """Begin a phase of `count` tasks; the phase before must be done."""
    agenda[_ORDER], agenda[_ORDER + 1], agenda[_ORDER + 2], agenda[_ORDER + 3] = kind, subject, detail, count
    agenda[_PHASE] += 1
    atomic_store(agenda, _DONE, 0)
    phase = agenda[_PHASE] & _MOST
    atomic_store(agenda, _CLAIM, (phase << (2 * _BITS)) | (count << _BITS))


@kernel
def order(agenda: IndexArray) -> tuple[int, int, int]:
    """Return kind, subject and detail of the phase; call it only after claiming a task of it."""
    return agenda[_ORDER], agenda[_ORDER + 1], agenda[_ORDER + 2]


@kernel
def claim(agenda: IndexArray) -> int:
    """Return the number of a task that no other thread has, or NONE, or CLOSED."""
    while True:
        word: int = atomic_load(agenda, _CLAIM)
        if word < 0:
            return CLOSED
        task = word & _MOST
        if task >= (word >> _BITS) & _MOST:
            return NONE
        if atomic_exchange(agenda, _CLAIM, word, word + 1):
            return task


@kernel
def report(agenda: IndexArray) -> None:
    """Report that a claimed task is done."""
    atomic_add(agenda, _DONE, 1)


@kernel
def await_others(agenda: IndexArray) -> None:
    """Wait until all tasks of the phase are done; none must be left to claim."""
    while atomic_load(agenda, _DONE) < agenda[_ORDER + 3]:
        give_way()


@kernel
def claim_or_leave(agenda: IndexArray) -> int:
    """Return the number of a task for a helper, or CLOSED if it has to leave."""
    task = claim(agenda)
    if task != NONE:
        return task
    started = steady_seconds()
    while steady_seconds() - started < PATIENCE_S:
        give_way()
        task = claim(agenda)
        if task != NONE:
            return task
    return CLOSED


VARIABLE = "OMP_NUM_THREADS"
"""Environment variable for the number of threads of a process, as numeric libraries use it."""

MOST_THREADS = 8
"""Largest default number of threads: beyond, memory bandwidth is the limit."""


def usable_threads() -> int:
    """Return the default number of threads: OMP_NUM_THREADS, or the cores that this process may use."""
    named = os.environ.get(VARIABLE, "").split(",")[0].strip()
    if named.isascii() and named.isdigit() and int(named) > 0:
        return int(named)
    return min(usable_cores(), MOST_THREADS)


class Crew:
    """Threads that carry out calls, which any thread may submit.

    Attributes:
        resting: Whether calls are dropped.
    """

    def __init__(self) -> None:
        self._threads: list[Thread] = []
        self._calls: SimpleQueue[Callable[[], object] | None] = SimpleQueue()
        self._hiring = Lock()
        self.resting = False

    def ask(self, helpers: int, call: Callable[[], object]) -> None:
        """Submit a call to a number of threads, without waiting for them."""
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
        """End all threads; the next call to `ask` starts new ones."""
        with self._hiring:
            threads, self._threads = self._threads, []
            for _ in threads:
                self._calls.put(None)
            for thread in threads:
                thread.join()

    def forget(self) -> None:
        """Drop the parent's threads in a forked process."""
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
    """Give no thread help in this context, to measure the benefit of help."""
    before, _crew.resting = _crew.resting, True
    try:
        yield
    finally:
        _crew.resting = before


class Teamwork:
    """Piece of work that one thread leads and others support.

    Args:
        threads: Number of threads, the leading one included, >= 1.
        lead, support: Kernels of the same arguments; the last one is the agenda, which assigns the tasks.
    """

    def __init__(self, threads: int, lead: Callable[..., Any], support: Callable[..., Any]) -> None:
        self._helpers = threads - 1
        self._lead, self._support = OneSignature(lead), OneSignature(support)
        self._compiled = False

    def __call__(self, *arguments: Any) -> Any:
        """Run `lead` with helpers and return its result. A helper that comes late finds the agenda closed."""
        agenda = open_agenda()
        if self._helpers and not self._compiled:  # compile here, not in a helper while the leader works alone
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
