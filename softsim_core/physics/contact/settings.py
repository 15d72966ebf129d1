"""Contact settings: distances, friction and accuracy of the contact solver."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from softsim_core.base import FieldError, need_positive

MOST_ITERATIONS = 100_000
ALARM_DISTANCE, CONTACT_DISTANCE, TOLERANCE = 0.004, 0.001, 1.0e-8
"""Defaults in [m] where all bodies are at least THICK."""
THICK = 0.004
"""Thickness in [m] of the thinnest body below which the defaults shrink in proportion."""
_APART = 4.0
"""Ratio of the two distances where one is given and the default of the other does not fit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PairFriction:
    """Friction of one pair, instead of the general coefficient.

    Attributes:
        between: Names of two collision surfaces, or of bodies, which stand for all their surfaces.
        friction: Coulomb coefficient in [-], >= 0.
    """

    between: tuple[str, str]
    friction: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.friction < math.inf:
            raise FieldError("friction_pairs", "friction", self.friction, ">= 0")


class ContactLimits(NamedTuple):
    """Contact settings of a scene with all defaults resolved.

    Attributes:
        alarm_distance, contact_distance: Distances in [m].
        iterations: Largest number of sweeps of the contact solver.
        tolerance: Complementarity residual in [m] below which the solver stops.
    """

    alarm_distance: float
    contact_distance: float
    iterations: int
    tolerance: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactSettings:
    """Contact settings of a scene.

    Attributes:
        alarm_distance: Contact margin in [m]: pairs closer than this are examined, > contact_distance. None:
            0.004, or the thickness of the thinnest moving body if that is smaller.
        contact_distance: Gap in [m] at which bodies come to rest, >= 0. None: 0.001, or a quarter of the
            thickness of the thinnest moving body if that is below 0.004.
        friction: Coulomb coefficient in [-], >= 0, of all pairs but those of `friction_pairs`.
        friction_pairs: Pairs with their own coefficient; if several match, the last one counts.
        iterations: Largest number of sweeps of the contact solver, 1 to 100 000.
        tolerance: Complementarity residual in [m] below which the solver stops, > 0. None: 1e-8, or less in
            proportion to the thickness of the thinnest moving body if that is below 0.004.
    """

    alarm_distance: float | None = None
    contact_distance: float | None = None
    friction: float = 0.5
    friction_pairs: tuple[PairFriction, ...] = ()
    iterations: int = 1000
    tolerance: float | None = None

    def __post_init__(self) -> None:
        if self.tolerance is not None:
            need_positive("contact", "tolerance", self.tolerance, "m")
        if self.contact_distance is not None and not 0.0 <= self.contact_distance < math.inf:
            raise FieldError("contact", "contact_distance", self.contact_distance, ">= 0 m")
        least = self.contact_distance or 0.0
        if self.alarm_distance is not None and not least < self.alarm_distance < math.inf:
            raise FieldError(
                "contact",
                "alarm_distance",
                self.alarm_distance,
                f"> contact_distance = {least} m, which is >= 0",
            )
        if not 0.0 <= self.friction < math.inf:
            raise FieldError("contact", "friction", self.friction, ">= 0")
        if not 1 <= self.iterations <= MOST_ITERATIONS:
            raise FieldError("contact", "iterations", self.iterations, f"1 to {MOST_ITERATIONS}")

    def limits(self, thickness: float = math.inf) -> ContactLimits:
        """Return the distances and tolerance of a scene, defaults included.

        Args:
            thickness: Thickness of the thinnest moving body in [m].
        """
        share = min(1.0, thickness / THICK)
        alarm, gap = self.alarm_distance, self.contact_distance
        if gap is None:
            gap = share * CONTACT_DISTANCE
            if alarm is not None and gap >= alarm:
                gap = alarm / _APART
        if alarm is None:
            alarm = share * ALARM_DISTANCE
            if alarm <= gap:
                alarm = _APART * gap
        tolerance = share * TOLERANCE if self.tolerance is None else self.tolerance
        return ContactLimits(alarm, gap, self.iterations, tolerance)
