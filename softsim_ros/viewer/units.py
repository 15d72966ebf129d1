"""Ranges of sliders from the limits of joints."""

from __future__ import annotations

import math
from typing import Final

from softsim_core.scene.description import JointDescription

STEP: Final = {"revolute": 0.001, "prismatic": 0.0001, "cable": 0.0001}
"""Step of a slider in [rad] or [m]."""

FREE_RANGE: Final = {"revolute": math.pi, "prismatic": 0.1, "cable": 0.05}
"""Half width of a slider in [rad] or [m] where a joint has no limit."""


def joint_range(joint: JointDescription) -> tuple[float, float, float]:
    """Lower end, upper end and step of a joint's slider, in [rad] or [m]."""
    free = FREE_RANGE.get(joint.kind, 1.0)
    lower = joint.limits.lower if math.isfinite(joint.limits.lower) else -free
    upper = joint.limits.upper if math.isfinite(joint.limits.upper) else free
    return lower, upper, STEP.get(joint.kind, 0.001)


def slider_value(joint: JointDescription, position: float) -> float:
    """What a joint's slider shows for a position in [rad] or [m]: within its ends, without idle digits."""
    lower, upper, step = joint_range(joint)
    return min(max(round(position, 1 - round(math.log10(step))), lower), upper)
