"""What reinforces a body: thin layers on its faces, and fibres in it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from softsim_core.errors import MaterialError, SceneError
from softsim_core.fem.materials import Material
from softsim_core.fem.materials.strain import FIBRES, MEMBRANE
from softsim_core.values import DIRECTION, POINT, Box, FieldError, Sphere, Vector, need_finite, need_positive


@dataclass(frozen=True, slots=True, kw_only=True)
class LayerDescription:
    """A thin sheet bonded to faces of a body, such as paper or fabric: it hardly stretches and bends freely.

    Attributes:
        name: Unique in its body.
        thickness: In [m], > 0.
        young_modulus: In its plane in [Pa], > 0.
        poisson_ratio: In its plane in [-], in (-1, 0.5).
        density: Mass per volume in [kg/m^3], >= 0.
        box, sphere: The region, exactly one: faces of the body whose nodes all lie in it are covered, also
            those of hollows.
    """

    name: str
    thickness: float
    young_modulus: float
    poisson_ratio: float = 0.3
    density: float = 0.0
    box: Box | None = None
    sphere: Sphere | None = None

    def __post_init__(self) -> None:
        owner = f"layer {self.name}"
        need_positive(owner, "thickness", self.thickness, "m")
        if not 0.0 <= self.density < math.inf:
            raise FieldError(owner, "density", self.density, ">= 0 kg/m^3")
        if (self.box is None) == (self.sphere is None):
            raise SceneError(f"{owner}: give exactly one of box and sphere")
        _check(owner, self.law, self.values)

    @property
    def law(self) -> Material:
        """Its material law."""
        return MEMBRANE

    @property
    def values(self) -> dict[str, float]:
        """The parameters of its law by name."""
        return {"young_modulus": self.young_modulus, "poisson_ratio": self.poisson_ratio}

    def changed(self, values: Mapping[str, float]) -> LayerDescription:
        """The same layer with other values of its law."""
        values = {**self.values, **values}
        return replace(self, young_modulus=values["young_modulus"], poisson_ratio=values["poisson_ratio"])


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisDescription:
    """A line in space: a point on it in [m] and its direction, of any length but zero."""

    through: Vector = field(metadata=POINT)
    direction: Vector = field(metadata=DIRECTION)

    def __post_init__(self) -> None:
        need_finite("axis", "through", self.through)
        _need_direction("axis", self.direction)


@dataclass(frozen=True, slots=True, kw_only=True)
class FibresDescription:
    """Fibres smeared over a part of a body, which carry tension only.

    Attributes:
        name: Unique in its body.
        stiffness: k of k/2 (I4 - 1)^2 in [Pa], > 0, with the square of the stretch I4: a quarter of the
            fibres' Young modulus, times the share of the volume that they fill.
        direction: Where they all run; or give `around`.
        around: They are wound around this axis.
        angle_deg: Of wound ones, how much they rise from the circle towards the axis, in [deg], -90 to 90.
        radii: Of wound ones, they lie between these two distances from the axis in [m]; None: anywhere.
        box, sphere: They run through cells whose middle lies there; neither: through the whole body.
    """

    name: str
    stiffness: float
    direction: Vector | None = field(default=None, metadata=DIRECTION)
    around: AxisDescription | None = None
    angle_deg: float = 0.0
    radii: tuple[float, float] | None = None
    box: Box | None = None
    sphere: Sphere | None = None

    def __post_init__(self) -> None:
        owner = f"fibres {self.name}"
        if (self.direction is None) == (self.around is None):
            raise SceneError(f"{owner}: give exactly one of direction and around")
        if self.direction is not None:
            _need_direction(owner, self.direction)
        if not -90.0 <= self.angle_deg <= 90.0:
            raise FieldError(owner, "angle_deg", self.angle_deg, "between -90 and 90 deg")
        if self.radii is not None:
            if self.around is None:
                raise SceneError(
                    f"{owner}: radii belong to fibres that are wound around an axis; remove them"
                )
            if not 0.0 <= self.radii[0] < self.radii[1] < math.inf:
                raise FieldError(owner, "radii", list(self.radii), "two rising distances >= 0 m")
        if self.box is not None and self.sphere is not None:
            raise SceneError(f"{owner}: give at most one of box and sphere")
        _check(owner, self.law, self.values)

    @property
    def law(self) -> Material:
        """Its material law."""
        return FIBRES

    @property
    def values(self) -> dict[str, float]:
        """The parameters of its law by name."""
        return {"stiffness": self.stiffness}

    def changed(self, values: Mapping[str, float]) -> FibresDescription:
        """The same fibres with other values of their law."""
        return replace(self, stiffness=values.get("stiffness", self.stiffness))


def _need_direction(owner: str, direction: Vector) -> None:
    need_finite(owner, "direction", direction)
    if not any(direction):
        raise FieldError(owner, "direction", list(direction), "a vector that is not zero")


def _check(owner: str, law: Material, values: Mapping[str, float]) -> None:
    try:
        law.values(values)
    except MaterialError as error:
        raise FieldError(owner, error.name, error.value, error.allowed.removeprefix("must be ")) from error
