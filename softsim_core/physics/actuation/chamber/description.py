"""Description of a chamber in a scene: typed, in SI units."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np

from softsim_core.base import (
    POINT,
    PRESSURE,
    VOLUME,
    FieldError,
    IndexArray,
    JointUnits,
    SceneError,
    Vector,
    listing,
    need_finite,
    need_positive,
)
from softsim_core.physics.actuation import ActuatorDescription, EditedNumber, Gas
from softsim_core.physics.mesh import TetMesh, cavities, encloses

ATMOSPHERE = 101_325.0
"""Absolute pressure of the ambient air in [Pa]: the standard atmosphere."""

VACUUM = -ATMOSPHERE
"""Gauge pressure of vacuum in [Pa]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChamberDescription(ActuatorDescription):
    """Cavity of a body that a joint of kind "chamber" fills.

    Its coordinate is the growth of its volume since the start of the scene, in [m^3]; its effort is the gauge
    pressure in it, in [Pa]. The joint's position is the actual growth.

    Attributes:
        body: Name of the deformable body that encloses it.
        inside: A point in the cavity in [m], at the start of the scene; None: all cavities of the body are
            one chamber.
        surface: Alternatively the name of a surface of the body's mesh, such as a physical group of a Gmsh
            file: the faces around the chamber. If it is open, its rim must be flat and attached to the
            world; a plate closes it there.
        control: "pressure": commands are pressures in [Pa], as for a regulator. "volume": commands are the
            volume that a pump has moved in, in [m^3]: water, or air at atmospheric pressure; this also works
            where more volume needs less pressure.
        max_pressure, min_pressure: Bounds of the pressure in [Pa]; under volume control, air is let out or
            in at a bound.
        line_compliance: Volume that the line between pump and cavity takes up in [m^3/Pa], >= 0: a volume
            command q at a pressure p leaves q - p * line_compliance for the cavity.
        line_volume: Volume in [m^3] of the line, >= 0, which like the cavity is filled with air; air
            compresses. None: the filling is incompressible, such as water.
        exponent: k of that air in [-], in 1 to 2: (atmosphere + pressure) V^k is constant. 1 is slow
            (isothermal), 1.4 quick (adiabatic).
        leak: Leak rate, as volume at atmospheric pressure in [m^3/s], per pressure in [Pa], >= 0.
        flow_limit: Largest flow of pump or regulator in or out, as volume at atmospheric pressure in [m^3/s],
            > 0.
        atmosphere: Absolute pressure of the ambient air in [Pa], > 0.
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
        """Units of the chamber's joint: command as pressure or volume, position as volume, effort in [Pa]."""
        return JointUnits(PRESSURE if self.control == "pressure" else VOLUME, VOLUME, "Pa")

    @property
    def by_effort(self) -> bool:
        """Whether commands are pressures instead of volumes."""
        return self.control == "pressure"

    @property
    def gas(self) -> Gas:
        """Bounds of its pressure, and the pressure around it."""
        return Gas(self.min_pressure, self.max_pressure, self.atmosphere)

    @property
    def edited_numbers(self) -> tuple[EditedNumber, ...]:
        """The limits of commanded pressures."""
        limits = ("Largest", "upper"), ("Smallest", "lower")
        found = (EditedNumber(f"{label} pressure [kPa]", 1e-3, ("limits", key)) for label, key in limits)
        return tuple(found) if self.by_effort else ()

    def enclosed_nodes(self, joint: str, mesh: TetMesh) -> IndexArray:
        """Return the nodes around the chamber, or those of the surface that it names."""
        if self.surface is None:
            return np.unique(closed_hollow(joint, self, mesh))
        if self.surface not in mesh.surfaces:
            raise SceneError(f"its mesh has no surface {self.surface!r}; it has {listing(mesh.surfaces)}")
        return np.unique(mesh.surfaces[self.surface])

    def bodies(self) -> dict[str, str | None]:
        """Return the name of the body that encloses the chamber, under the key `body`."""
        return {"body": self.body}


def closed_hollow(name: str, described: ChamberDescription, mesh: TetMesh) -> IndexArray:
    """Return the faces of a chamber that its body's mesh encloses, shape (k, 3) or (k, 6).

    Raises:
        SceneError: there is none, or none around the point `inside`.
    """
    found = cavities(mesh)
    if not found:
        raise SceneError(
            f"chamber {name}: body {described.body} encloses no hollow; a chamber needs one that its mesh "
            "closes all around, or a named `surface` that ends at the world"
        )
    if described.inside is None:
        return np.concatenate(found)
    place = np.array(described.inside, dtype=float)
    around = [faces for faces in found if encloses(mesh.points, faces, place)]
    if not around:
        middles = [mesh.points[np.unique(faces)].mean(axis=0).round(6).tolist() for faces in found]
        raise SceneError(
            f"chamber {name}: {place.tolist()} m lies in no hollow of body {described.body}; the middles of "
            f"its hollows are {middles} m"
        )
    return around[0]
