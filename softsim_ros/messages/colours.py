"""A colour scale for stress whose lightness grows evenly with the value.

Colours are chosen in OKLCH, where equal steps of lightness look equal: from dark blue through magenta and
orange to light yellow, so that order is seen even in grey.
Source: Ottosson 2020, "A perceptual color space for image processing".
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from softsim_core.arrays import Array

STEPS = 256
_LIGHTNESS = (0.25, 0.95)
_HUE_DEG = (265.0, 460.0)  # blue, magenta (330), red (380), orange (410), yellow (460 = 100)
_CHROMA = 0.17

_LMS_OF_LAB = np.array(
    [
        [1.0, 0.3963377774, 0.2158037573],
        [1.0, -0.1055613458, -0.0638541728],
        [1.0, -0.0894841775, -1.2914855480],
    ]
)
_RGB_OF_LMS = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.7076147010],
    ]
)


def linear_rgb(lightness: Array, chroma: Array, hue_rad: Array) -> Array:
    """Linear red, green, blue of OKLCH colours, shape (n, 3); outside 0..1 where a screen cannot follow."""
    lab = np.stack([lightness, chroma * np.cos(hue_rad), chroma * np.sin(hue_rad)], axis=-1)
    rgb: Array = (lab @ _LMS_OF_LAB.T) ** 3 @ _RGB_OF_LMS.T
    return rgb


def screen_rgb(linear: Array) -> Array:
    """Screen (sRGB) values in 0..1 of linear ones, shape (n, 3); clipped to what a screen can show."""
    clipped = np.clip(linear, 0.0, 1.0)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1.0 / 2.4) - 0.055)


def colour_table(steps: int = STEPS) -> NDArray[np.float32]:
    """The scale as sRGB rows from lowest to highest value, shape (steps, 3), chroma lowered to fit."""
    along = np.linspace(0.0, 1.0, steps)
    lightness = _LIGHTNESS[0] + (_LIGHTNESS[1] - _LIGHTNESS[0]) * along
    hue = np.radians(_HUE_DEG[0] + (_HUE_DEG[1] - _HUE_DEG[0]) * along)
    low, high = np.zeros(steps), np.full(steps, _CHROMA)
    for _ in range(30):  # bisection for the largest chroma a screen can show
        middle = 0.5 * (low + high)
        rgb = linear_rgb(lightness, middle, hue)
        shown = ((rgb >= 0.0) & (rgb <= 1.0)).all(axis=1)
        low, high = np.where(shown, middle, low), np.where(shown, high, middle)
    return screen_rgb(linear_rgb(lightness, low, hue)).astype(np.float32)


_TABLE = colour_table()


def stress_colours(values: Array, highest: float) -> NDArray[np.float32]:
    """Screen (sRGB) colours of values, the scale running from 0 to `highest`.

    Args:
        values: Stress in [Pa], shape (n,), >= 0.
        highest: Stress in [Pa] that gets the last colour; values above share it; with 0 all get the
            first.

    Returns:
        Red, green, blue in 0..1, shape (n, 3).
    """
    if not highest > 0.0:
        return np.repeat(_TABLE[:1], len(values), axis=0)
    steps = np.clip(np.rint(np.asarray(values) * ((STEPS - 1) / highest)), 0, STEPS - 1)
    return _TABLE[steps.astype(np.intp)]
