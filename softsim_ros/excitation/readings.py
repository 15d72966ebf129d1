"""Messages with stamps and times of arrival, and rows of a table made of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from softsim_core.base.arrays import Array
from softsim_core.lab.identification.replay import SAME

ONE_CLOCK_S: Final = 1.0
"""Stamps of two topics whose clocks are farther apart than this in [s] are told by two clocks."""


class Readings:
    """Messages of a topic as rows of numbers; filled by the thread that serves a node, read by another.

    Args:
        topic: The topic's name, for messages.
        numbers: The numbers of a message, always as many; an empty sequence leaves the message out.
    """

    def __init__(self, topic: str, numbers: Callable[[Any], Sequence[float]]) -> None:
        self.topic, self._numbers = topic, numbers
        self._rows: list[tuple[float, float, tuple[float, ...]]] = []
        self.arrived = time.monotonic()
        self.frame = ""

    def __call__(self, message: Any) -> None:
        """Take a message."""
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
        """Stamps (k,), arrivals (k,) in [s] and numbers (k, n) of the messages after the first `count`."""
        rows = self._rows[count:]
        stamps, arrivals = (np.array([row[i] for row in rows], dtype=float) for i in (0, 1))
        return stamps, arrivals, np.array([row[2] for row in rows], dtype=float).reshape(len(rows), -1)


def silence_s(readings: Readings) -> float:
    """How long nothing has come, in [s]."""
    return time.monotonic() - readings.arrived


def times_of(all_readings: Sequence[tuple[Array, Array]]) -> list[Array]:
    """Times of the messages of several topics on one clock: their stamps, else when they arrived.

    Args:
        all_readings: Stamps and arrivals of each topic, each with one message or more.
    """
    ahead = [float(np.median(stamps - arrivals)) for stamps, arrivals in all_readings]
    one_clock = max(ahead) - min(ahead) < ONE_CLOCK_S
    return [stamps if one_clock else arrivals for stamps, arrivals in all_readings]


def not_before(begin: float | None, all_readings: Sequence[tuple[Array, Array, Array]]) -> list[Array]:
    """The numbers (k, n) of topics without what was so before `begin`.

    A topic that is behind says for a while what was before; its stamps tell, where all are of one clock.

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
"""A free motion that is a smaller part of the whole is none: then the whole counts."""

STILL_MM: Final = 0.02
"""A sensor that drifts by less from one half of a look to the next, or by less than its noise, is at rest."""


def drifts(places: Array) -> bool:
    """Whether places (k, 3) in [mm] that were read one after the other move by more than their noise.

    Noise is told by neighbours, which a slow motion hardly sets apart.
    """
    half = len(places) // 2
    drift = np.abs(places[half:].mean(axis=0) - places[:half].mean(axis=0))
    noise = np.diff(places, axis=0).std(axis=0) / np.sqrt(2.0)
    return bool((drift > np.maximum(STILL_MM, 4.0 * noise * np.sqrt(2.0 / half))).any())


def whole(numbers: Array) -> Array:
    """The rows of numbers (k, n) that are all finite."""
    return np.asarray(numbers[np.isfinite(numbers).all(axis=1)])


def rings_from(times: Array, commands: Array, places: Array) -> float:
    """From when on a free motion is seen, in [s]; 0: the body follows its joints, and hardly rings.

    Args:
        times: Of rows in [s], shape (k,).
        commands: Of the joints, shape (k, j).
        places: Of a sensor, shape (k, 3).
    """
    moved = np.flatnonzero(np.abs(np.diff(commands, axis=0)).max(axis=1) > 0.0)
    if not len(moved):
        return 0.0
    free = moved[-1] + 1
    noise = places[: moved[0] + 1].std(axis=0).max()
    swing = places[free:].std(axis=0).max()
    return round(float(times[free]), 4) if swing > max(FREE * places.std(axis=0).max(), 3.0 * noise) else 0.0


def told_at(times: Array, commands: Array, when: Array, *, after: bool) -> Array:
    """What joints were told at the times of rows: of a simulator where they stand after the step to come."""
    if after:
        index = np.searchsorted(times, when + SAME, side="right")
    else:
        index = np.searchsorted(times, when + SAME, side="right") - 1
    return np.asarray(commands[np.clip(index, 0, len(times) - 1)])
