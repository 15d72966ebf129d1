"""Joints on sliders and curves: their units, and ranges from their limits."""

from __future__ import annotations

import math
from typing import Final

from softsim_core.scene.joint import JointDescription
from softsim_core.units import Unit

FINEST: Final = 1.0e-6
"""Steps of SI below this cannot be read on the page; the unit for people takes its place."""


def unit_on_page(unit: Unit) -> tuple[float, str]:
    """How many of the unit of sliders and curves are one of SI, and its name: SI, but ml for volumes."""
    return (unit.per_si, unit.shown) if unit.step < FINEST else (1.0, unit.si)


def slider_label(joint: JointDescription) -> str:
    """A joint's name, with the unit of its slider where that is not of SI."""
    factor, name = unit_on_page(joint.units.command)
    return joint.name if factor == 1.0 else f"{joint.name} [{name}]"


def joint_range(joint: JointDescription) -> tuple[float, float, float]:
    """Lower end, upper end and step of a joint's slider, in its unit on the page."""
    unit = joint.units.command
    factor, _ = unit_on_page(unit)
    free = unit.reach
    lower = joint.limits.lower if math.isfinite(joint.limits.lower) else -free
    upper = joint.limits.upper if math.isfinite(joint.limits.upper) else free
    if factor == 1.0:
        return lower, upper, unit.step
    return round(lower * factor, 9), round(upper * factor, 9), round(unit.step * factor, 9)


def slider_value(joint: JointDescription, position: float) -> float:
    """What a joint's slider shows for a command in SI: within its ends, without idle digits."""
    lower, upper, step = joint_range(joint)
    factor, _ = unit_on_page(joint.units.command)
    return min(max(round(position * factor, 1 - round(math.log10(step))), lower), upper)


def command_of(joint: JointDescription, shown: float) -> float:
    """The command in SI for what a joint's slider shows; at its ends the limits, to the last digit."""
    factor, _ = unit_on_page(joint.units.command)
    return joint.limits.clamp(shown / factor)
