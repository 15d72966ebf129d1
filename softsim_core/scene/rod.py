"""Slender bodies and reinforcements: rods, thin layers on faces, fibres; typed, SI."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Literal, TypeAlias, get_args

import numpy as np

from softsim_core.base import (
    DIRECTION,
    POINT,
    Array,
    Box,
    FieldError,
    MaterialError,
    Placement,
    SceneError,
    Sphere,
    Vector,
    listing,
    need_finite,
    need_not_negative,
    need_positive,
    need_unit,
    vector,
)
from softsim_core.physics.fem.materials import FIBRES, MEMBRANE, Material
from softsim_core.physics.mesh import place


@dataclass(frozen=True, slots=True, kw_only=True)
class LayerDescription:
    """A thin sheet on faces of a body, such as paper or fabric: stiff in its plane, flexible in bending.

    Attributes:
        name: Unique in its body.
        thickness: In [m], > 0.
        young_modulus: In its plane in [Pa], > 0.
        poisson_ratio: In its plane in [-], in (-1, 0.5).
        density: Mass per volume in [kg/m^3], >= 0.
        box, sphere: The region, exactly one: it covers faces of the body with all nodes inside, including
            those of cavities.
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
        need_not_negative(owner, "density", self.density, "kg/m^3")
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

    def with_values(self, values: Mapping[str, float]) -> LayerDescription:
        """Return the same layer with other values of its law."""
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
    """Fibres distributed over a part of a body, which carry tension only.

    Attributes:
        name: Unique in its body.
        stiffness: k of k/2 (I4 - 1)^2 in [Pa], > 0, with the square of the stretch I4: a quarter of the
            fibres' Young modulus, times their volume fraction.
        direction: Direction of straight fibres; or give `around`.
        around: Axis of wound fibres.
        angle_deg: Angle of wound fibres from the circle towards the axis, in [deg], -90 to 90.
        radii: Least and largest distance of wound fibres from the axis in [m]; None: any distance.
        box, sphere: They run through cells with their middle inside; neither: through the whole body.
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

    def with_values(self, values: Mapping[str, float]) -> FibresDescription:
        """Return the same fibres with other values of their law."""
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


SectionShape: TypeAlias = Literal["rectangle", "ellipse"]
NaturalShape: TypeAlias = Literal["as_drawn", "straight"]
RodEnd: TypeAlias = Literal["start", "end"]
MOST_ELEMENTS, MOST_ACROSS = 100_000, 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class LayerOfRodDescription:
    """One of the layers of a section, ordered from its low to its high side along the first axis.

    Attributes:
        share: Part of the thickness, > 0; the sum of all is 1.
        modulus_ratio: Young modulus over that of the body's material, > 0.
    """

    share: float
    modulus_ratio: float

    def __post_init__(self) -> None:
        need_positive("layer of a rod", "share", self.share, "")
        need_positive("layer of a rod", "modulus_ratio", self.modulus_ratio, "")


@dataclass(frozen=True, slots=True, kw_only=True)
class RodSectionDescription:
    """The cross-section of a rod.

    Attributes:
        shape: "rectangle" or "ellipse" (a circle where both sizes are equal).
        size: Full extent along the first and the second axis in [m], > 0.
        end_size: Full extent at the end of a tapered rod; None: it is not tapered.
        wall: Thickness of the wall of a tube in [m], less than half of each size; None: it is solid.
        layers: Layers of a solid rectangle of several materials; none: it has one material.
        stiffness: Replaces the stiffness of shape and material: against stretch in [N], shear along both axes
            in [N], bending along both axes in [N m^2] and twist in [N m^2]; the values scale with the
            material's moduli and factors when these are tuned.
    """

    shape: SectionShape
    size: tuple[float, float]
    end_size: tuple[float, float] | None = None
    wall: float | None = None
    layers: tuple[LayerOfRodDescription, ...] = ()
    stiffness: tuple[float, float, float, float, float, float] | None = None

    def __post_init__(self) -> None:
        owner = "section of a rod"
        if self.shape not in get_args(SectionShape):
            raise FieldError(owner, "shape", repr(self.shape), f"one of {listing(get_args(SectionShape))}")
        for name, sizes in (("size", self.size), ("end_size", self.end_size or self.size)):
            for each in sizes:
                need_positive(owner, name, each, "m")
        if self.wall is not None:
            need_positive(owner, "wall", self.wall, "m")
            if 2.0 * self.wall >= min(*self.size, *(self.end_size or self.size)):
                raise FieldError(owner, "wall", self.wall, "less than half of each size")
        if self.layers:
            if self.shape != "rectangle" or self.wall is not None or self.stiffness is not None:
                raise SceneError(
                    f"{owner}: only a solid rectangle has layers; remove layers, wall or stiffness"
                )
            shares = [each.share for each in self.layers]
            if not math.isclose(sum(shares), 1.0, rel_tol=1e-6):
                raise FieldError(owner, "layers", shares, "shares whose sum is 1")
        for each in self.stiffness or ():
            need_positive(owner, "stiffness", each, "N or N m^2")


@dataclass(frozen=True, slots=True, kw_only=True)
class RodClampDescription:
    """A compliant clamp at an end of a rod: a short rigid piece, relative to which the end moves.

    The piece continues along the tangent by `length`; its far end is fixed by the rod's attachment. The end
    of the rod rotates about its own centre; an angle a requires half the stiffness times sin(2 a).

    Attributes:
        translation: Stiffness in [N/m] along the tangent and the first and second axis, each > 0; .inf: as
            stiff as the piece.
        rotation: Stiffness in [N m/rad] against bending along the first and the second axis, and twist; as
            above.
        length: In [m], > 0; None: a thousandth of the rod's.
    """

    translation: Vector = (math.inf, math.inf, math.inf)
    rotation: Vector = (math.inf, math.inf, math.inf)
    length: float | None = None

    def __post_init__(self) -> None:
        for name, values in (("translation", self.translation), ("rotation", self.rotation)):
            if not all(value > 0.0 for value in values):
                raise FieldError("clamp of a rod", name, list(values), "three numbers > 0, or .inf")
        if self.length is not None:
            need_positive("clamp of a rod", "length", self.length, "m")

    @property
    def stiffness(self) -> Array:
        """Stiffness of stretch, shear, bending and twist in [N/m] and [N m/rad], inf where rigid, (6,)."""
        return np.array([*self.translation, *self.rotation])


@dataclass(frozen=True, slots=True, kw_only=True)
class RodDescription:
    """A slender body that bends, twists and stretches.

    Attributes:
        centreline: Two or more points of its initial centre; a smooth curve interpolates them.
        placement: Placement of points and directions in the world; without a scale the points are in [m].
        section: Its cross-section.
        first_axis: Direction to which the first axis of the first section is nearest; from there the axes
            follow the curve without rotating about it.
        start_direction, end_direction: Unit tangents at its ends; None: from the points.
        elements: Number of cells, of three sections each; up to 100 000.
        across: For a rod with an element of tetrahedra: number of boxes of six tetrahedra along the first and
            the second axis, up to 1000; `elements` is their number along the rod.
        natural: Shape without load: "as_drawn" or "straight".
        stiffness_factors: Factors on the stiffness along it: pairs of the share of the length up to which a
            factor holds, and the factor, > 0; the shares increase, the last is 1. None: 1 everywhere.
        curvature: In [1/m] beyond that of the natural shape: along the first and the second axis, and twist
            in [rad/m].
        length: Length without load in [m]; None: that of the centreline.
        start_clamp, end_clamp: Compliant clamp at an end; None: rigid.
    """

    centreline: tuple[Vector, ...]
    section: RodSectionDescription
    placement: Placement = Placement()
    first_axis: Vector = (0.0, 0.0, 1.0)
    start_direction: Vector | None = None
    end_direction: Vector | None = None
    elements: int = 8
    across: tuple[int, int] = (1, 1)
    natural: NaturalShape = "as_drawn"
    stiffness_factors: tuple[tuple[float, float], ...] = ()
    curvature: Vector = (0.0, 0.0, 0.0)
    length: float | None = None
    start_clamp: RodClampDescription | None = None
    end_clamp: RodClampDescription | None = None

    def __post_init__(self) -> None:
        if len(self.centreline) < 2:
            raise FieldError("rod", "centreline", list(self.centreline), "two or more points")
        for point in self.centreline:
            need_finite("rod", "centreline", point)
        need_finite("rod", "first_axis", self.first_axis)
        shares = [0.0, *(share for share, _ in self.stiffness_factors)]
        if self.stiffness_factors and not (
            all(before < share for before, share in pairwise(shares)) and math.isclose(shares[-1], 1.0)
        ):
            raise FieldError("rod", "stiffness_factors", shares[1:], "shares that increase up to 1")
        for _, factor in self.stiffness_factors:
            need_positive("rod", "stiffness_factors", factor, "")
        need_finite("rod", "curvature", self.curvature)
        for end in ("start_direction", "end_direction"):
            if (direction := getattr(self, end)) is not None:
                need_unit("rod", end, direction)
        if not 1 <= self.elements <= MOST_ELEMENTS:
            raise FieldError("rod", "elements", self.elements, f"1 to {MOST_ELEMENTS}")
        if not all(1 <= boxes <= MOST_ACROSS for boxes in self.across):
            raise FieldError("rod", "across", list(self.across), f"two numbers from 1 to {MOST_ACROSS}")
        if self.natural not in get_args(NaturalShape):
            raise FieldError(
                "rod", "natural", repr(self.natural), f"one of {listing(get_args(NaturalShape))}"
            )
        if self.length is not None:
            need_positive("rod", "length", self.length, "m")
            if self.natural == "as_drawn":
                raise SceneError(
                    "rod: a rod that is without load as it is drawn is as long as its centreline; "
                    "remove length, or set natural to straight"
                )

    @property
    def beyond_tetrahedra(self) -> list[str]:
        """Names of the given fields that tetrahedra do not support; none: the rod can be tetrahedra."""
        section = self.section
        beyond_by_field = {
            "section.shape": section.shape != "rectangle",
            "section.wall": section.wall is not None,
            "section.layers": bool(section.layers),
            "section.stiffness": section.stiffness is not None,
            "curvature": any(self.curvature),
            "stiffness_factors": bool(self.stiffness_factors),
            "start_clamp": self.start_clamp is not None,
            "end_clamp": self.end_clamp is not None,
        }
        return [name for name, beyond in beyond_by_field.items() if beyond]

    def end_place(self, start: bool) -> tuple[float, float, float]:
        """Return the initial position of its start or end in the world in [m], without a clamp."""
        point = np.array([self.centreline[0 if start else -1]], dtype=float)
        return vector(place(point, self.placement)[0])
