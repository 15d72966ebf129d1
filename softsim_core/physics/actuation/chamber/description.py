"""What a scene says of a chamber; typed, SI."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar, Literal

from softsim_core.base import (
    POINT,
    PRESSURE,
    VOLUME,
    FieldError,
    JointUnits,
    SceneError,
    Vector,
    need_finite,
    need_positive,
)
from softsim_core.physics.actuation import ActuatorDescription

ATMOSPHERE = 101_325.0
"""Pressure of the air around in [Pa], against vacuum: the standard atmosphere."""

VACUUM = -ATMOSPHERE
"""Pressure of nothing against the air around in [Pa]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChamberDescription(ActuatorDescription):
    """The hollow of a body that a joint of kind "chamber" fills.

    Its coordinate is by how much its volume has grown since the scene was built, in [m^3]; its effort is the
    pressure in it against the air around, in [Pa]. The joint's position is the real growth.

    Attributes:
        body: Name of the deformable body that encloses it.
        inside: A place in the hollow in [m], where the scene is built; None: all hollows of the body are one
            chamber.
        surface: Or the name of a surface of the body's mesh, such as a physical group of a Gmsh file: the
            faces around the chamber. Where it is open, its rim has to be attached to the world, flat: a plate
            closes it there.
        control: "pressure": commands are pressures in [Pa], as of a regulator. "volume": commands are what a
            pump has pushed in, in [m^3]: water, or air as it is in the atmosphere; this goes on where more
            volume needs less pressure.
        max_pressure, min_pressure: The pressure stays between them, in [Pa]; by volume, more or less is let
            out or in.
        line_compliance: What the line between pump and hollow takes up in [m^3/Pa], >= 0: a command of volume
            q with a pressure p leaves q - p * line_compliance for the hollow.
        line_volume: Volume in [m^3] of the line, >= 0, which is filled with air as the hollow is; air
            compresses. None: what fills both does not, such as water.
        exponent: k of that air in [-], in 1 to 2: (atmosphere + pressure) V^k stays what it was. 1 is slow
            (isothermal), 1.4 quick (adiabatic).
        leak: What leaks out, as volume in the atmosphere in [m^3/s], per pressure in [Pa], >= 0.
        flow_limit: Most that pump or regulator move in or out, as volume in the atmosphere in [m^3/s], > 0.
        atmosphere: Pressure of the air around against vacuum in [Pa], > 0.
    """

    kind: ClassVar[str] = "chamber"
    body: str
    inside: Vector | None = field(default=None, metadata=POINT)
    surface: str | None = None
    control: Literal["pressure", "volume"] = "pressure"
    max_pressure: float = math.inf
    min_pressure: float = VACUUM
    line_compliance: float = 0.0
    line_volume: float | None = None
    exponent: float = 1.0
    leak: float = 0.0
    flow_limit: float = math.inf
    atmosphere: float = ATMOSPHERE

    def __post_init__(self) -> None:
        if self.inside is not None:
            need_finite("chamber", "inside", self.inside)
        if self.inside is not None and self.surface is not None:
            raise SceneError("chamber: give at most one of inside and surface")
        if not self.min_pressure <= 0.0 <= self.max_pressure:
            raise FieldError(
                "chamber", "min_pressure and max_pressure", [self.min_pressure, self.max_pressure],
                "a range in Pa with 0 in it",
            )  # fmt: skip
        need_at_least_zero = ("line_compliance", "m^3/Pa"), ("line_volume", "m^3"), ("leak", "m^3/(s Pa)")
        for name, unit in need_at_least_zero:
            if not 0.0 <= (getattr(self, name) or 0.0) < math.inf:
                raise FieldError("chamber", name, getattr(self, name), f">= 0 {unit}")
        if not 1.0 <= self.exponent <= 2.0:
            raise FieldError("chamber", "exponent", self.exponent, "in 1 to 2")
        if not self.flow_limit > 0.0:
            raise FieldError("chamber", "flow_limit", self.flow_limit, "> 0 m^3/s")
        need_positive("chamber", "atmosphere", self.atmosphere, "Pa")

    @property
    def units(self) -> JointUnits:
        """See ActuatorDescription."""
        return JointUnits(PRESSURE if self.control == "pressure" else VOLUME, VOLUME, "Pa")

    @property
    def by_effort(self) -> bool:
        """See ActuatorDescription."""
        return self.control == "pressure"

    def bodies(self) -> dict[str, str | None]:
        """See ActuatorDescription."""
        return {"body": self.body}
