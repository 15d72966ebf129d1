"""Animations: a factor 0..1 over simulated time; once, in a loop, or back and forth."""

from __future__ import annotations

import math
from typing import Literal, TypeAlias, get_args

from softsim_core.errors import SceneError
from softsim_core.wrong_names import known_names

Mode: TypeAlias = Literal["once", "loop", "pingpong"]

_DIGITS = 9
"""Phases are rounded to this many decimals: steps of dt then hit 0.05, 0.5, 1 exactly, without drift."""


def _phase(elapsed: float, duration: float) -> float:
    return max(0.0, round(elapsed / duration, _DIGITS))


def check_animation(duration: float, mode: str, delay: float = 0.0) -> None:
    """Refuse an animation that cannot be played.

    Raises:
        SceneError: the duration in [s] is not > 0, the mode is unknown, or the delay in [s] is not >= 0.
    """
    if not 0.0 < duration < math.inf:
        raise SceneError(f"an animation's duration must be > 0 s, not {duration}")
    if mode not in get_args(Mode):
        raise SceneError(
            f"unknown animation mode {mode!r}; {known_names(mode, get_args(Mode), 'known modes:')}"
        )
    if not 0.0 <= delay < math.inf:
        raise SceneError(f"an animation's delay must be >= 0 s, not {delay}")


def factor_at(elapsed: float, duration: float, mode: Mode = "once") -> float:
    """Factor of an animation after `elapsed` seconds.

    Args:
        elapsed: Time since factor 0 in [s]; negative counts as 0.
        duration: Seconds from factor 0 to factor 1, > 0.
        mode: "once": rises to 1 and stays. "loop": rises again and again; a round ends with 1, and the step
            after that goes on from 0. "pingpong": rises to 1, falls to 0, rises again.

    Returns:
        Factor in 0..1, without drift: after n steps of dt it is the nearest float to its decimal value.

    Raises:
        SceneError: unknown mode, or a duration that is not > 0.
    """
    check_animation(duration, mode)
    phase = _phase(elapsed, duration)
    if mode == "once":
        return min(phase, 1.0)
    if mode == "loop":
        return 0.0 if phase == 0.0 else round(phase - (math.ceil(phase) - 1), _DIGITS)
    return round(1.0 - abs(1.0 - math.fmod(phase, 2.0)), _DIGITS)


def is_over(elapsed: float, duration: float, mode: Mode = "once") -> bool:
    """Whether the factor has reached its end: only in mode "once"."""
    return mode == "once" and _phase(elapsed, duration) >= 1.0
