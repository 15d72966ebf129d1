"""Time several functions in turns, so that a slow moment of the machine affects all of them."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from softsim_core.base.arrays import Array


def nothing() -> None:
    """Prepare nothing."""


@dataclass(frozen=True)
class Contender:
    """A function to time.

    Attributes:
        name: Key of its times in the result.
        call: Timed function, called once per sample.
        calls: Samples per turn.
        prepare: Called before each turn, not timed.
    """

    name: str
    call: Callable[[], object]
    calls: int = 1
    prepare: Callable[[], object] = nothing


@contextmanager
def no_garbage_collection() -> Iterator[None]:
    """Run the garbage collector on entry, and disable it until exit."""
    gc.collect()
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def take_turns(contenders: Sequence[Contender], rounds: int) -> dict[str, Array]:
    """Time every contender in every round; each round begins with another one.

    Returns:
        Times in [ms] by the contenders' unique names, shape (rounds * calls,).
    """
    times = {each.name: np.empty(rounds * each.calls) for each in contenders}
    for contender in contenders:  # compiles, fills caches
        contender.prepare()
        contender.call()
    with no_garbage_collection():
        for turn in range(rounds):
            for offset in range(len(contenders)):
                contender = contenders[(turn + offset) % len(contenders)]
                contender.prepare()
                for sample in range(contender.calls):
                    started = perf_counter()
                    contender.call()
                    times[contender.name][turn * contender.calls + sample] = 1e3 * (perf_counter() - started)
    return times


def restart_every(turns: int, restart: Callable[[], None]) -> Callable[[], None]:
    """Return a function for `Contender.prepare` that restarts an engine before every `turns`-th turn.

    An engine that iterates has little to do once the body rests, so a timed body must fall.
    """
    turn = 0

    def prepare() -> None:
        nonlocal turn
        if turn % turns == 0:
            restart()
        turn += 1

    return prepare
