"""From what sensors and joints said to the rows of a table."""

from __future__ import annotations

from typing import Final

import numpy as np

from softsim_core.arrays import Array
from softsim_core.identification.replay import SAME

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
