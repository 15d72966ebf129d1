"""How surfaces meet: distances, friction, and how exactly the contact law is solved."""

from __future__ import annotations

import math
from dataclasses import dataclass

from softsim_core.values import FieldError, need_positive

MOST_ITERATIONS = 100_000


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


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactSettings:
    """How surfaces meet.

    Attributes:
        alarm_distance: The contact margin: pairs closer than this in [m] are looked at, > contact_distance.
        contact_distance: Gap in [m] at which bodies come to rest, >= 0.
        friction: Coulomb coefficient in [-], >= 0, of all pairs but those of `friction_pairs`.
        friction_pairs: Pairs with a coefficient of their own; of several that fit, the last one counts.
        iterations: Most sweeps of the contact solver, 1 to 100 000.
        tolerance: It stops below this complementarity residual in [m], > 0.
    """

    alarm_distance: float = 0.004
    contact_distance: float = 0.001
    friction: float = 0.5
    friction_pairs: tuple[PairFriction, ...] = ()
    iterations: int = 1000
    tolerance: float = 1.0e-8

    def __post_init__(self) -> None:
        need_positive("contact", "tolerance", self.tolerance, "m")
        if not 0.0 <= self.contact_distance < self.alarm_distance < math.inf:
            raise FieldError(
                "contact",
                "alarm_distance",
                self.alarm_distance,
                f"> contact_distance = {self.contact_distance} m, which is >= 0",
            )
        if not 0.0 <= self.friction < math.inf:
            raise FieldError("contact", "friction", self.friction, ">= 0")
        if not 1 <= self.iterations <= MOST_ITERATIONS:
            raise FieldError("contact", "iterations", self.iterations, f"1 to {MOST_ITERATIONS}")
