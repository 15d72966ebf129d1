"""How surfaces meet: distances, friction, and how exactly the contact law is solved."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from softsim_core.base import FieldError, need_positive

MOST_ITERATIONS = 100_000
ALARM_DISTANCE, CONTACT_DISTANCE, TOLERANCE = 0.004, 0.001, 1.0e-8
"""Defaults in [m] where all bodies are at least THICK."""
THICK = 0.004
"""Thickness in [m] of the thinnest body below which the defaults shrink in proportion to it."""
_APART = 4.0
"""Ratio of the two distances where one is given and the default of the other does not fit it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PairFriction:
    """Friction between two things, instead of what holds for all others.

    Attributes:
        between: Names of two collision surfaces, or of bodies (then of all surfaces of theirs).
        friction: Coulomb coefficient in [-], >= 0.
    """

    between: tuple[str, str]
    friction: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.friction < math.inf:
            raise FieldError("friction_pairs", "friction", self.friction, ">= 0")


class ContactLimits(NamedTuple):
    """What ContactSettings come to in a scene.

    Attributes:
        alarm_distance, contact_distance: Distances in [m].
        iterations: Most sweeps of the contact solver.
        tolerance: Complementarity residual in [m] below which it stops.
    """

    alarm_distance: float
    contact_distance: float
    iterations: int
    tolerance: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactSettings:
    """How surfaces meet.

    Attributes:
        alarm_distance: The contact margin: pairs closer than this in [m] are looked at, > contact_distance.
            None: 0.004, or as much as the thinnest moving body where that is thinner.
        contact_distance: Gap in [m] at which bodies come to rest, >= 0. None: 0.001, or a quarter of the
            thinnest moving body where that is thinner than 0.004.
        friction: Coulomb coefficient in [-], >= 0, of all pairs but those of `friction_pairs`.
        friction_pairs: Pairs with a coefficient of their own; of several that fit, the last one counts.
        iterations: Most sweeps of the contact solver, 1 to 100 000.
        tolerance: It stops below this complementarity residual in [m], > 0. None: 1e-8, or less in proportion
            to the thinnest moving body where that is thinner than 0.004.
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
            thickness: Of the thinnest moving body in [m].
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
