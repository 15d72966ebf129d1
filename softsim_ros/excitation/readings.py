"""Messages with stamps and times of arrival, and rows of a table made from them."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from softsim_core.base import Array
from softsim_core.lab.identification import SAME

ONE_CLOCK_S: Final = 1.0
"""Largest difference in [s] of the offsets of two topics with the same clock."""


class Readings:
    """Messages of a topic as rows of numbers; filled by the thread that serves a node, read by another.

    Args:
        topic: The topic's name, for messages.
        numbers: Returns the numbers of a message, always as many; an empty sequence skips the message.
    """

    def __init__(self, topic: str, numbers: Callable[[Any], Sequence[float]]) -> None:
        self.topic, self._numbers = topic, numbers
        self._rows: list[tuple[float, float, tuple[float, ...]]] = []
        self.arrived = time.monotonic()
        self.frame = ""

    def __call__(self, message: Any) -> None:
        """Store a message."""
        now, numbers = time.time(), tuple(self._numbers(message))
        if not numbers or (self._rows and len(numbers) != len(self._rows[0][2])):
            return
        header = getattr(message, "header", None)
        stamp = 0.0 if header is None else header.stamp.sec + 1e-9 * header.stamp.nanosec
        self.frame = "" if header is None else str(header.frame_id)
        self.arrived = time.monotonic()
        self._rows.append((stamp or now, now, numbers))

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def newest(self) -> float | None:
        """Stamp of the newest message in [s]."""
        return self._rows[-1][0] if self._rows else None

    def since(self, count: int) -> tuple[Array, Array, Array]:
        """Return stamps, arrivals and numbers of the messages after the first `count`.

        Stamps (k,) and arrivals (k,) are in [s]; numbers have shape (k, n).
        """
        rows = self._rows[count:]
        stamps, arrivals = (np.array([row[i] for row in rows], dtype=float) for i in (0, 1))
        return stamps, arrivals, np.array([row[2] for row in rows], dtype=float).reshape(len(rows), -1)


def times_of(all_readings: Sequence[tuple[Array, Array]]) -> list[Array]:
    """Return times of the messages of several topics on one clock: their stamps, else their arrivals.

    Args:
        all_readings: Stamps and arrivals of each topic, each with one message or more.
    """
    ahead = [float(np.median(stamps - arrivals)) for stamps, arrivals in all_readings]
    one_clock = max(ahead) - min(ahead) < ONE_CLOCK_S
    return [stamps if one_clock else arrivals for stamps, arrivals in all_readings]


def not_before(begin: float | None, all_readings: Sequence[tuple[Array, Array, Array]]) -> list[Array]:
    """Return the numbers (k, n) of topics without those measured before `begin`.

    A delayed topic still reports earlier values for a while; its stamps show which, if all have the same
    clock.

    Args:
        begin: By the stamps of the first topic, in [s]; None: not known.
        all_readings: Stamps, arrivals and numbers of each topic, see Readings.since.
    """
    numbers = [each[2] for each in all_readings]
    if begin is None or not all(map(len, numbers)):
        return numbers
    times = times_of([(stamps, arrivals) for stamps, arrivals, _ in all_readings])
    if not np.array_equal(times[0], all_readings[0][0]):
        return numbers
    return [said[when >= begin] for said, when in zip(numbers, times, strict=True)]


FREE: Final = 0.02
"""Smallest free motion as a fraction of the whole motion; below it the whole motion is used."""

STILL_MM: Final = 0.02
"""Largest drift in [mm] of a sensor at rest from one half of an observation to the next.

A sensor that drifts by less than its noise is at rest, too.
"""


def drifts(places: Array) -> bool:
    """Return whether consecutive positions (k, 3) in [mm] move by more than their noise.

    The noise is estimated from differences of neighbours, on which a slow motion has little influence.
    """
    half = len(places) // 2
    drift = np.abs(places[half:].mean(axis=0) - places[:half].mean(axis=0))
    noise = np.diff(places, axis=0).std(axis=0) / np.sqrt(2.0)
    return bool((drift > np.maximum(STILL_MM, 4.0 * noise * np.sqrt(2.0 / half))).any())


def whole(numbers: Array) -> Array:
    """Return the rows of numbers (k, n) that are all finite."""
    return np.asarray(numbers[np.isfinite(numbers).all(axis=1)])


def rings_from(times: Array, commands: Array, places: Array) -> float:
    """Return the time in [s] from which a free motion is visible.

    Return 0 if the body follows its joints and hardly oscillates.

    Args:
        times: Times of rows in [s], shape (k,).
        commands: Commands of the joints, shape (k, j).
        places: Positions of a sensor, shape (k, 3).
    """
    moved = np.flatnonzero(np.abs(np.diff(commands, axis=0)).max(axis=1) > 0.0)
    if not len(moved):
        return 0.0
    free = moved[-1] + 1
    noise = places[: moved[0] + 1].std(axis=0).max()
    swing = places[free:].std(axis=0).max()
    return round(float(times[free]), 4) if swing > max(FREE * places.std(axis=0).max(), 3.0 * noise) else 0.0


def commands_at(times: Array, commands: Array, when: Array, *, after: bool) -> Array:
    """Return the joint commands at the times of rows; with `after`, those in effect after the next step.

    Joint states of a simulator need `after`.
    """
    index = np.searchsorted(times, when + SAME, side="right") - (0 if after else 1)
    return np.asarray(commands[np.clip(index, 0, len(times) - 1)])
