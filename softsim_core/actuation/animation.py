"""Animations: a callback with a factor 0..1 over simulated time; once, in a loop, or back and forth."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

from softsim_core.errors import SceneError, SnapshotError, SoftSimError, listing

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
        raise SceneError(f"unknown animation mode {mode!r}; known modes: {listing(get_args(Mode))}")
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


@dataclass(frozen=True, slots=True, eq=False)
class Animation:
    """A callback driven with a factor over a duration.

    Attributes:
        callback: Called with the factor in 0..1, once a step: first with 0, in mode "once" last with 1.
        duration: Seconds from factor 0 to factor 1, > 0.
        mode: "once", "loop" or "pingpong"; see `factor_at`.
        delay: Seconds between play and the first call, >= 0.
        on_done: Called once, right after the last callback; loop and pingpong never end by themselves.

    Raises:
        SceneError: a duration, mode or delay out of range.
    """

    callback: Callable[[float], None]
    duration: float
    mode: Mode = "once"
    delay: float = 0.0
    on_done: Callable[[], None] | None = None

    def __post_init__(self) -> None:
        check_animation(self.duration, self.mode, self.delay)


@dataclass(slots=True)
class _Playing:
    animation: Animation
    due: float  # when the first call is allowed
    start: float | None = None  # time of the first call


class AnimationPlayer:
    """Plays animations in simulated time; call `begin_step` before every step.

    Args:
        animations: Known animations; calls and the state refer to them by their index.
    """

    def __init__(self, animations: Sequence[Animation] = ()) -> None:
        self._animations = list(animations)
        self._playing: dict[int, _Playing] = {}

    def add(self, animation: Animation) -> int:
        """Make an animation known, without playing it; returns its index."""
        self._animations.append(animation)
        return len(self._animations) - 1

    def play(self, index: int, time: float) -> None:
        """Start an animation at simulated time `time` in [s]; one that is playing starts anew.

        Raises:
            SceneError: unknown index.
        """
        if not 0 <= index < len(self._animations):
            raise SceneError(f"unknown animation {index}; {len(self._animations)} are known")
        animation = self._animations[index]
        self._playing.pop(index, None)  # the last one started comes last in a step
        self._playing[index] = _Playing(animation, time + animation.delay)

    def stop(self, index: int | None = None) -> None:
        """Stop one animation, or all of them, where it is; on_done is not called."""
        if index is None:
            self._playing.clear()
        else:
            self._playing.pop(index, None)

    @property
    def playing(self) -> tuple[int, ...]:
        """Indices of the animations that play or wait for their delay, in the order they were started."""
        return tuple(self._playing)

    def begin_step(self, time: float) -> None:
        """Call the callbacks of all playing animations for the step that starts at `time` in [s].

        Raises:
            SceneError: a callback failed; its animation is stopped. Errors of the suite pass unchanged.
        """
        for index, playing in list(self._playing.items()):
            if self._playing.get(index) is playing:  # a callback may stop or restart others
                self._advance(index, playing, time)

    def _advance(self, index: int, playing: _Playing, time: float) -> None:
        animation = playing.animation
        if playing.start is None:
            if round(time - playing.due, _DIGITS) < 0.0:
                return
            playing.start = time
        elapsed = time - playing.start
        over = is_over(elapsed, animation.duration, animation.mode)
        if over:
            del self._playing[index]  # before the callbacks: they may play it again
        try:
            animation.callback(factor_at(elapsed, animation.duration, animation.mode))
            if over and animation.on_done is not None:
                animation.on_done()
        except SoftSimError:
            self._playing.pop(index, None)
            raise
        except Exception as error:
            self._playing.pop(index, None)
            name = getattr(animation.callback, "__qualname__", "callback")
            problem = f"{type(error).__name__}: {error}"
            raise SceneError(
                f"animation {index} ({name}) failed at t = {time:.3f} s and is stopped: {problem}"
            ) from error

    def state(self) -> tuple[tuple[float, float, float], ...]:
        """What is playing, as plain numbers: (index, due time, start time or nan) each, in order."""
        return tuple(
            (float(index), playing.due, math.nan if playing.start is None else playing.start)
            for index, playing in self._playing.items()
        )

    def restore(self, state: Sequence[Sequence[float]]) -> None:
        """Go back to a `state`; animations continue with the same factors.

        Raises:
            SnapshotError: the state does not fit the known animations; nothing is changed.
        """
        playing: dict[int, _Playing] = {}
        for entry in state:
            if len(entry) != 3 or not 0 <= entry[0] < len(self._animations) or entry[0] != int(entry[0]):
                raise SnapshotError(
                    f"animation state {tuple(entry)} does not fit {len(self._animations)} animations"
                )
            index, due, start = int(entry[0]), float(entry[1]), float(entry[2])
            playing[index] = _Playing(self._animations[index], due, None if math.isnan(start) else start)
        self._playing = playing
