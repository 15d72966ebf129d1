"""Conversion between SI (internally, on topics) and the units of people and files (degrees, millimetres)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, Literal, NamedTuple, TypeAlias

MILLIMETRE = 1.0e-3
"""One millimetre in [m]."""


def radians(angle_deg: float) -> float:
    """Convert an angle from [deg] to [rad]."""
    return math.radians(angle_deg)


def degrees(angle_rad: float) -> float:
    """Convert an angle from [rad] to [deg]."""
    return math.degrees(angle_rad)


class Unit(NamedTuple):
    """A unit of SI, and the unit in which its values are displayed.

    Attributes:
        si: Name of the SI unit.
        shown: Name of the displayed unit.
        per_si: Number of displayed units per SI unit.
        step: Step of a slider, in SI.
        reach: Range of a slider to both sides if a value has no limits, in SI.
    """

    si: str
    shown: str
    per_si: float
    step: float
    reach: float


class JointUnits(NamedTuple):
    """Units of a joint's command, position and effort; efforts are displayed in SI."""

    command: Unit
    position: Unit
    effort: str


ANGLE = Unit("rad", "deg", 180.0 / math.pi, 0.001, math.pi)
LENGTH = Unit("m", "mm", 1e3, 0.0001, 0.1)
SHORTENING = LENGTH._replace(reach=0.05)
FORCE = Unit("N", "N", 1.0, 0.01, 10.0)
PRESSURE = Unit("Pa", "kPa", 1e-3, 10.0, 2e4)
VOLUME = Unit("m^3", "ml", 1e6, 1e-8, 1e-5)

Quantity: TypeAlias = Literal["angle", "length", "time", "force", "pressure", "volume", "own"]


class Scale(NamedTuple):
    """A unit in which files give a quantity, and one unit in SI."""

    quantity: Quantity
    si: float


SCALES: Final[Mapping[str, Scale]] = {
    "rad": Scale("angle", 1.0),
    "deg": Scale("angle", math.pi / 180.0),
    "m": Scale("length", 1.0),
    "cm": Scale("length", 1e-2),
    "mm": Scale("length", 1e-3),
    "s": Scale("time", 1.0),
    "ms": Scale("time", 1e-3),
    "us": Scale("time", 1e-6),
    "N": Scale("force", 1.0),
    "mN": Scale("force", 1e-3),
    "Pa": Scale("pressure", 1.0),
    "kPa": Scale("pressure", 1e3),
    "mbar": Scale("pressure", 1e2),
    "bar": Scale("pressure", 1e5),
    "m^3": Scale("volume", 1.0),
    "ml": Scale("volume", 1e-6),
    "SI": Scale("own", 1.0),
}
"""Units of columns in measured tables; "SI": each joint's own unit, such as N and N m for loads."""
