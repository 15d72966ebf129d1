"""The named edge between SI (inside, on topics) and what people and files use (degrees, millimetres)."""

from __future__ import annotations

import math

MILLIMETRE = 1.0e-3
"""One millimetre in [m]."""


def radians(angle_deg: float) -> float:
    """Angle in [rad] of an angle in [deg]."""
    return math.radians(angle_deg)


def degrees(angle_rad: float) -> float:
    """Angle in [deg] of an angle in [rad]."""
    return math.degrees(angle_rad)
