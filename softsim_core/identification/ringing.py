r"""How a motion rings down: frequency and damping ratio, and what an unknown release changes of it.

Along the direction in which a point moves most, its place is described by

.. math:: c + a e^{-d t} \cos(2 \pi f t + \varphi) + b e^{-t / \tau}

with the slow creep of a third of the time that is looked at; the damping ratio is
:math:`d / \sqrt{d^2 + (2 \pi f)^2}`.

A body that a hand lets go swings with an amplitude and a phase that depend on the hand, while frequency and
decay are the body's. Where the release is not known, a fit of the whole motion makes up for a wrong amplitude
by wrong damping; `release_errors` is the part of the errors that it must not see.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from softsim_core.arrays import Array, BoolArray

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

    @property
    def decay(self) -> float:
        """Rate d in [1/s] at which the swing gets smaller."""
        return 2.0 * np.pi * self.frequency * self.damping / float(np.sqrt(1.0 - self.damping**2))


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

    def misfit(x: Array) -> Array:
        shapes = _shapes(t, float(np.exp(x[0])), float(x[1]), t[-1])
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


def release_errors(times: Array, places: Array, errors: Array, rows: BoolArray) -> Array | None:
    """Part of a model's errors that another amplitude and phase of its own swing would explain.

    Both are common to all sensors. Frequency and decay are those of the model, so that errors of these stay.

    Args:
        times: In [s], increasing, shape (k,).
        places: Where the model has the sensors in [m], shape (k, s, 3).
        errors: Model minus measurement in [m], shape (k, s, 3).
        rows: To which amplitude and phase are fitted, shape (k,).

    Returns:
        The part in [m], shape (k, s, 3); None where the model does not ring in these rows.
    """
    widest = int(np.argmax(places[rows].var(axis=0).sum(axis=-1)))
    swing = ringing(times[rows], places[rows, widest])
    if swing is None:
        return None
    t = times - times[rows][0]
    shapes = _shapes(t, swing.decay, swing.frequency, float(t[rows][-1]))
    flat = places.reshape(len(t), -1)
    _, cosine, sine, _ = np.linalg.lstsq(shapes[rows], flat[rows], rcond=None)[0]
    as_released = shapes[:, 1:2] * cosine + shapes[:, 2:3] * sine
    quarter_later = shapes[:, 1:2] * sine - shapes[:, 2:3] * cosine
    both = np.stack([as_released, quarter_later], axis=-1)
    amounts = np.linalg.lstsq(both[rows].reshape(-1, 2), errors[rows].ravel(), rcond=None)[0]
    return np.asarray((both @ amounts).reshape(errors.shape))


def _shapes(t: Array, decay: float, frequency: float, last: float) -> Array:
    """Rest, two swings a quarter apart and the creep, at times (k,) from the first, shape (k, 4)."""
    swing, angle = np.exp(-decay * t), 2.0 * np.pi * frequency * t
    return np.stack(
        [np.ones_like(t), swing * np.cos(angle), swing * np.sin(angle), np.exp(-3.0 * t / last)], axis=1
    )
