"""Ranges of sliders from the limits of joints."""

from __future__ import annotations

import math

from softsim_core.scene.description import JointDescription


def joint_range(joint: JointDescription) -> tuple[float, float, float]:
    """Lower end, upper end and step of a joint's slider, in the unit of its command of SI."""
    unit = joint.units.command
    free = unit.reach
    lower = joint.limits.lower if math.isfinite(joint.limits.lower) else -free
    upper = joint.limits.upper if math.isfinite(joint.limits.upper) else free
    return lower, upper, unit.step


def slider_value(joint: JointDescription, position: float) -> float:
    """What a joint's slider shows for a command: within its ends, without idle digits."""
    lower, upper, step = joint_range(joint)
    return min(max(round(position, 1 - round(math.log10(step))), lower), upper)
