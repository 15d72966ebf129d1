"""Commands by joint name, of some joints or all, with the time they were given; refused whole or taken."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Final

from softsim_core.errors import CommandError, listing

MOST_LATE_S: Final = 0.5
"""A command given longer ago than this in [s], or so far ahead, is refused: clocks differ or it got stuck."""

NOTHING: Final = 1e-9
"""A velocity or effort up to this, in [rad/s], [m/s], [N m] or [N], is round-off and counts as 0."""

LONGEST_NAME: Final = 40
"""So many characters of a foreign name are shown in a refusal."""


def check_named_command(
    names: Sequence[str], positions: Sequence[float], joints: Sequence[str]
) -> dict[str, float]:
    """Positions by joint of a command for some joints, in any order.

    A NaN stands for no command: that joint is left out.

    Args:
        names: Joints of the command, each once.
        positions: In [rad] or [m], one a name.
        joints: Joints that there are.

    Raises:
        CommandError: unknown or repeated names, another number of positions, or an infinite one.
    """
    if len(names) > len(joints):
        raise _refused(f"it names {len(names)} joints of {len(joints)} ({listing(joints)})")
    if len(names) != len(positions):
        raise _refused(f"it has {len(positions)} positions for {len(names)} names; give one for each")
    unknown = [name for name in names if name not in joints]
    if unknown:
        raise _refused(f"unknown joints {_short(unknown)}; known joints: {listing(joints)}")
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise _refused(f"it names {_short(twice)} twice; name every joint once")
    command = {name: float(value) for name, value in zip(names, positions, strict=True) if value == value}
    for name, value in command.items():
        if math.isinf(value):
            raise _refused(f"{value} for joint {name} is not finite; NaN stands for no command")
    return command


def check_positions_only(velocities: Sequence[float], efforts: Sequence[float]) -> None:
    """Refuse a command that says more than positions, which nothing here obeys.

    Raises:
        CommandError: it has velocities or efforts that are neither NaN nor 0 but for round-off.
    """
    if says_something(velocities) or says_something(efforts):
        raise _refused(
            "only positions are taken; leave velocity and effort empty, or fill them with NaN or 0"
        )


def says_something(values: Sequence[float]) -> bool:
    """Whether any of the values of an optional field is neither NaN nor 0, but for round-off."""
    return any(abs(value) > NOTHING for value in values)


def check_age(given_s: float, now_s: float) -> None:
    """Refuse a command given too long ago, or in the future; time 0 says nothing.

    Args:
        given_s: Its time stamp in [s].
        now_s: The time of whoever obeys, on the clock of the stamps.

    Raises:
        CommandError: further from now than MOST_LATE_S.
    """
    late = now_s - given_s
    if given_s != 0.0 and abs(late) > MOST_LATE_S:
        side = f"{late:.1f} s ago" if late > 0.0 else f"{-late:.1f} s ahead"
        raise _refused(
            f"it is stamped {side}, allowed are {MOST_LATE_S:g} s; use one clock, or stamp it 0 for now"
        )


def _short(names: Sequence[str]) -> str:
    return listing([name[:LONGEST_NAME] for name in names])


def _refused(problem: str) -> CommandError:
    return CommandError(f"joint command refused: {problem}; nothing was moved")
