r"""How a motion rings down: its frequency and damping ratio, told by the measurement and by a model.

Along the direction in which a point moves most, its place is described by

.. math:: c + a e^{-d t} \cos(2 \pi f t + \varphi) + b e^{-t / \tau}

with the slow creep of a third of the time that is looked at; the damping ratio is
:math:`d / \sqrt{d^2 + (2 \pi f)^2}`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from softsim_core.arrays import Array

FEWEST = 40
"""So many places tell a ringing."""

UNTOLD = 0.3
"""A motion of which the description leaves a larger part is no ringing."""


class Ringing(NamedTuple):
    """A damped swing.

    Attributes:
        frequency: In [Hz].
        damping: Ratio to critical damping.
    """

    frequency: float
    damping: float


def ringing(times: Array, places: Array) -> Ringing | None:
    """How a point rings; None where it does not.

    Args:
        times: In [s], increasing, shape (k,).
        places: In [m], shape (k, 3).
    """
    if len(times) < FEWEST:
        return None
    centred = places - places.mean(axis=0)
    along = centred @ np.linalg.svd(centred, full_matrices=False)[2][0]
    size = float(along.std())
    if not size > 0.0:
        return None
    t, z = times - times[0], along / size
    even = np.linspace(0.0, t[-1], len(t))
    left = np.interp(even, t, z) - np.polyval(np.polyfit(even, np.interp(even, t, z), 2), even)
    found: tuple[float, Array] | None = None
    strength = np.abs(np.fft.rfft(left, 8 * len(left)))
    rates = np.fft.rfftfreq(8 * len(left), even[1])
    start = float(rates[int(np.argmax(strength[1:])) + 1])

    def parts(decay: float, frequency: float) -> Array:
        swing = np.exp(-decay * t)
        angle = 2.0 * np.pi * frequency * t
        return np.stack(
            [np.ones_like(t), swing * np.cos(angle), swing * np.sin(angle), np.exp(-3.0 * t / t[-1])], axis=1
        )

    def misfit(x: Array) -> Array:
        shapes = parts(float(np.exp(x[0])), float(x[1]))
        return np.asarray(z - shapes @ np.linalg.lstsq(shapes, z, rcond=None)[0])

    for decay in (0.5, 2.0, 8.0):
        fit = least_squares(misfit, [np.log(decay), start], x_scale=[1.0, 0.05 * start])
        if found is None or fit.cost < found[0]:
            found = (float(fit.cost), fit.x)
    assert found is not None
    decay, frequency = float(np.exp(found[1][0])), abs(float(found[1][1]))
    if (
        np.sqrt(2.0 * found[0] / len(t)) > UNTOLD
        or frequency * t[-1] < 2.0
        or 2.0 * frequency > len(t) / t[-1]
    ):
        return None
    return Ringing(frequency, decay / float(np.hypot(decay, 2.0 * np.pi * frequency)))
