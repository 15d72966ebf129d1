"""The reference of the closed loop under the keys while it gives the goals: pure functions, SI."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

from softsim_core.units import degrees
from softsim_ros.teleop.state import TeleopState, TiltReference

TILT_STEP_RAD: Final = 0.1
"""How far one press turns the reference, in [rad]."""

TILT_KEYS: Final[Mapping[str, str]] = {
    "up": "tilt about y",
    "right": "tilt about x",
    "plus": "more tilt",
    "minus": "less tilt",
}
"""What each key does: the arrows choose an axis, in a frame with y up its x and z."""


@dataclass(frozen=True, slots=True)
class PublishTilt:
    """Publish a reference for the closed loop."""

    reference: TiltReference


def turn_reference(state: TeleopState, name: str) -> tuple[TeleopState, tuple[PublishTilt, ...]]:
    """The state after a goal key while the closed loop gives the goals, and the reference to publish.

    Args:
        state: What is known before.
        name: Name of the key; one that is not in TILT_KEYS does nothing.
    """
    reference = state.tilt
    if reference is None or name not in TILT_KEYS:
        return replace(state, message="nothing moved: the closed loop gives the goals"), ()
    if name in ("up", "right"):
        reference = reference._replace(axis="y" if name == "up" else "x")
        return replace(state, tilt=reference, message=tilt_line(reference)), ()
    step = TILT_STEP_RAD if name == "plus" else -TILT_STEP_RAD
    if reference.axis == "x":
        reference = reference._replace(x=round(reference.x + step, 9))
    else:
        reference = reference._replace(y=round(reference.y + step, 9))
    return replace(state, tilt=reference, message=tilt_line(reference)), (PublishTilt(reference),)


def tilt_line(reference: TiltReference) -> str:
    """The reference for the display, in degrees, and which axis the keys turn."""
    x, y = (round(degrees(value), 1) + 0.0 for value in (reference.x, reference.y))  # + 0.0: no "-0.0"
    return f"tilt reference deg: x {x:.1f} y {y:.1f}   + and - turn {reference.axis}"
