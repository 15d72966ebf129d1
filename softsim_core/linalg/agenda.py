"""The agenda on which one thread writes work for others: phases of tasks that do not depend on each other.

What the tasks are is planned once, whatever the number of threads, and who does a task changes nothing in
it: results are the same bit by bit for any number of threads. The one who leads takes tasks like all others,
and waits for tasks only that somebody has begun: helpers that come late, or never, delay nothing.

An agenda serves one piece of work and is never used again, so that a helper that comes late finds it closed.
"""

from __future__ import annotations

import numpy as np

from softsim_core.arrays import IndexArray
from softsim_core.linalg.atomics import atomic_add, atomic_exchange, atomic_load, atomic_store, give_way
from softsim_core.linalg.compile import kernel
from softsim_core.linalg.simd import steady_seconds

_LINE = 8
"""Numbers in a cache line: what threads write stands in lines of its own."""

_CLAIM, _DONE, _PHASE, _ORDER = 0, _LINE, 2 * _LINE, 3 * _LINE
_BITS = 20
_MOST = (1 << _BITS) - 1
CLOSED, NONE = -2, -1
"""Instead of a task: there will be no more, and there is none for now."""

PATIENCE_S = 0.05
"""A helper that has found nothing to do for so long leaves."""


def open_agenda() -> IndexArray:
    """An agenda without tasks."""
    return np.zeros(4 * _LINE, np.int64)


def close_agenda(agenda: IndexArray) -> None:
    """Send all helpers away."""
    agenda[_CLAIM] = CLOSED


@kernel
def publish(agenda: IndexArray, kind: int, subject: int, detail: int, count: int) -> None:
    """Begin a phase of `count` tasks; the one before has to be done."""
    agenda[_ORDER], agenda[_ORDER + 1], agenda[_ORDER + 2], agenda[_ORDER + 3] = kind, subject, detail, count
    agenda[_PHASE] += 1
    atomic_store(agenda, _DONE, 0)
    phase = agenda[_PHASE] & _MOST
    atomic_store(agenda, _CLAIM, (phase << (2 * _BITS)) | (count << _BITS))


@kernel
def order(agenda: IndexArray) -> tuple[int, int, int]:
    """Kind, subject and detail of the phase; for those who have claimed a task of it."""
    return agenda[_ORDER], agenda[_ORDER + 1], agenda[_ORDER + 2]


@kernel
def claim(agenda: IndexArray) -> int:
    """The number of a task that nobody else has, or NONE, or CLOSED."""
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
    """Tell that a claimed task is done."""
    atomic_add(agenda, _DONE, 1)


@kernel
def await_others(agenda: IndexArray) -> None:
    """Wait until all tasks of the phase are done; none is left to claim."""
    while atomic_load(agenda, _DONE) < agenda[_ORDER + 3]:
        give_way()


@kernel
def claim_or_leave(agenda: IndexArray) -> int:
    """The number of a task for a helper, or CLOSED: it has to leave."""
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
