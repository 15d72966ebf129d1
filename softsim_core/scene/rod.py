"""Rods: slender bodies given by a centreline and their cross-section."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Literal, TypeAlias, get_args

import numpy as np

from softsim_core.arrays import Array
from softsim_core.errors import SceneError
from softsim_core.fem.materials.section import SECTION
from softsim_core.fem.rods import CIRCLE, RodSections
from softsim_core.mesh.placement import place, rotation_matrix
from softsim_core.mesh.rods import RodMesh, along_curve, carried_axes, rod_mesh
from softsim_core.values import FieldError, Placement, Vector, need_finite, need_positive, need_unit

SectionShape: TypeAlias = Literal["rectangle", "ellipse"]
NaturalShape: TypeAlias = Literal["as_drawn", "straight"]
RodEnd: TypeAlias = Literal["start", "end"]

SHEAR_SHARE = {"rectangle": 5.0 / 6.0, "ellipse": 0.9}
"""Part of the area that carries shear."""

ROUND = 12
"""Corners of the outline of an ellipse, for surfaces."""

CLAMP_SHARE = 1e-3
"""Length of a compliant clamp over that of its rod."""

_GAUSS = 0.5 + np.array([-0.5, 0.5]) / math.sqrt(3.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class LayerOfRodDescription:
    """One of the layers that a section is made of, from its low to its high side along the first axis.

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
        end_size: That at the end of the rod, between which it tapers; None: it does not.
        wall: Thickness of the wall of a tube in [m], less than half of each size; None: it is solid.
        layers: Of a solid rectangle of several materials; none: it has one.
        stiffness: Instead of those of shape and material: against stretch in [N], shear along both axes in
            [N], bending along both axes in [N m^2] and twist in [N m^2]; they scale with the material's
            moduli and factors when these are tuned.
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
            raise FieldError(owner, "shape", repr(self.shape), f"one of {', '.join(get_args(SectionShape))}")
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
            if not math.isclose(sum(layer.share for layer in self.layers), 1.0, rel_tol=1e-6):
                raise FieldError(
                    owner, "layers", [each.share for each in self.layers], "shares whose sum is 1"
                )
        for each in self.stiffness or ():
            need_positive(owner, "stiffness", each, "N or N m^2")


@dataclass(frozen=True, slots=True, kw_only=True)
class RodClampDescription:
    """What holds an end of a rod, where that gives way: a short piece in front of it.

    The piece goes on along the tangent by `length`; what holds the rod holds its far end.

    Attributes:
        translation: Stiffness in [N/m] along the tangent and the first and second axis, each > 0; .inf: as
            stiff as the rod itself.
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
        """Of stretch, shear, bending and twist, in [N/m] and [N m/rad], infinite where rigid, shape (6,)."""
        return np.array([*self.translation, *self.rotation])


@dataclass(frozen=True, slots=True, kw_only=True)
class RodDescription:
    """A slender body that bends, twists and stretches.

    Attributes:
        centreline: Points, two or more, that its centre begins on; a smooth curve goes through them.
        placement: Where they and the directions sit in the world; without a scale the points are in [m].
        section: Its cross-section.
        first_axis: Direction that the first axis of the first section is nearest to; from there the axes go
            along the curve without turning about it.
        start_direction, end_direction: Along the rod at its ends, of length 1; None: as the points say.
        elements: Number of cells, of three sections each.
        natural: Shape without load: "as_drawn" or "straight".
        curvature: In [1/m] beyond that of the natural shape: along the first and the second axis, and twist
            in [rad/m].
        length: Length without load in [m]; None: that of the centreline.
        start_clamp, end_clamp: What gives way between an end and what holds it; None: nothing.
    """

    centreline: tuple[Vector, ...]
    section: RodSectionDescription
    placement: Placement = Placement()
    first_axis: Vector = (0.0, 0.0, 1.0)
    start_direction: Vector | None = None
    end_direction: Vector | None = None
    elements: int = 8
    natural: NaturalShape = "as_drawn"
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
        need_finite("rod", "curvature", self.curvature)
        for end in ("start_direction", "end_direction"):
            if (direction := getattr(self, end)) is not None:
                need_unit("rod", end, direction)
        if self.elements < 1:
            raise FieldError("rod", "elements", self.elements, ">= 1")
        if self.natural not in get_args(NaturalShape):
            raise FieldError(
                "rod", "natural", repr(self.natural), f"one of {', '.join(get_args(NaturalShape))}"
            )
        if self.length is not None:
            need_positive("rod", "length", self.length, "m")
            if self.natural == "as_drawn":
                raise SceneError(
                    "rod: a rod that is without load as it is drawn is as long as its centreline; "
                    "remove length, or set natural to straight"
                )

    def end_place(self, start: bool) -> tuple[float, float, float]:
        """Where its start or its end begins in the world in [m], without a clamp."""
        point = np.array([self.centreline[0 if start else -1]], dtype=float)
        x, y, z = place(point, self.placement)[0].tolist()
        return x, y, z


@dataclass(frozen=True, slots=True, eq=False)
class DrawnRod:
    """A rod compiled: where its sections begin, and how stiff they are."""

    mesh: RodMesh
    sections: RodSections


def draw_rod(rod: RodDescription, name: str, values: Mapping[str, float]) -> DrawnRod:
    """Compile a rod.

    Args:
        rod: The rod.
        name: Of its body, for messages.
        values: Parameters of its material, which is of the law `rod`.

    Raises:
        MeshError: its centreline or first axis cannot be used.
    """
    moduli, holding = (each[0] for each in SECTION.scales(np.array([list(values.values())])))
    count = 2 * rod.elements + 1
    turn = rotation_matrix(rod.placement.rotation_deg)
    ends = [
        None if each is None else turn @ np.array(each, dtype=float)
        for each in (rod.start_direction, rod.end_direction)
    ]
    points = place(np.array(rod.centreline, dtype=float), rod.placement)
    centres, tangents, drawn = along_curve(points, count, name, (ends[0], ends[1]))
    axes = carried_axes(tangents, turn @ np.array(rod.first_axis, dtype=float), name)
    length = rod.length or drawn
    at_points = (np.arange(rod.elements)[:, None] + _GAUSS) / rod.elements
    at_sections = (np.arange(rod.elements)[:, None] + np.array([0.0, 0.5, 1.0])) / rod.elements
    area, line = _stiffness(rod.section, at_points, moduli)
    held, _ = _stiffness(rod.section, at_sections, moduli)
    sections = RodSections(
        lengths=np.full(rod.elements, length / rod.elements),
        area=area,
        line=line,
        across=held[..., None, None] * np.eye(3),
        curvature=np.broadcast_to(np.array(rod.curvature, dtype=float), (rod.elements, 3)),
        straight=np.full(rod.elements, rod.natural == "straight"),
        own=np.zeros(rod.elements, dtype=np.bool_),
        reach=0.5 * _sizes(rod.section, at_points.mean(axis=1)),
    )
    along = np.linspace(0.0, 1.0, count)
    for clamp, end in ((rod.start_clamp, 0), (rod.end_clamp, -1)):
        if clamp is None:
            continue
        reach = clamp.length or CLAMP_SHARE * length
        sections = _with_clamp(sections, clamp, end, reach, moduli, holding)
        tangent = axes[end][:, 0]
        steps = np.array([1.0, 0.5]) * reach
        if end == 0:
            centres = np.concatenate([centres[0] - steps[:, None] * tangent, centres])
            axes, along = np.concatenate([axes[:1], axes[:1], axes]), np.concatenate([[0.0, 0.0], along])
        else:
            centres = np.concatenate([centres, centres[-1] + steps[::-1, None] * tangent])
            axes, along = np.concatenate([axes, axes[-1:], axes[-1:]]), np.concatenate([along, [1.0, 1.0]])
    spread = _gyration(rod.section, along)[:, None] * CIRCLE
    outlines = 0.5 * _sizes(rod.section, along)[:, None] * _OUTLINES[rod.section.shape]
    return DrawnRod(rod_mesh(centres, axes, spread, outlines, name), sections)


def _with_clamp(
    sections: RodSections, clamp: RodClampDescription, end: int, length: float, moduli: Array, holding: Array
) -> RodSections:
    """With a further cell at an end, 0 or -1, for what gives way there."""
    own = np.diag(clamp.stiffness * length)
    rigid = np.isinf(clamp.stiffness)
    beside = sections.line[end, end] * np.sqrt(np.multiply.outer(moduli, moduli))
    own[rigid, rigid] = np.diagonal(beside)[rigid]
    across = sections.across[end, end] * holding
    cell = RodSections(
        lengths=np.array([length]),
        area=np.tile(sections.area[end, end], (1, 2)),
        line=np.tile(own, (1, 2, 1, 1)),
        across=np.tile(across, (1, 3, 1, 1)),
        curvature=np.zeros((1, 3)),
        straight=np.array([True]),
        own=np.array([True]),
        reach=sections.reach[[end]],
    )
    order = (cell, sections) if end == 0 else (sections, cell)
    names = [each.name for each in fields(RodSections)]
    return RodSections(**{name: np.concatenate([getattr(each, name) for each in order]) for name in names})


def _sizes(section: RodSectionDescription, along: Array) -> Array:
    """Full extent along both axes in [m] at parts of the length, shape (..., 2)."""
    start, end = np.array(section.size), np.array(section.end_size or section.size)
    return np.asarray(start + along[..., None] * (end - start))


def _moments(section: RodSectionDescription, along: Array) -> tuple[Array, Array, Array]:
    """Area in [m^2], shape (...), second moments in [m^4] along both axes, (..., 2), and twist's, (...)."""
    outer = _sizes(section, along)
    area, second, twist = _solid(section.shape, outer)
    if section.wall is None:
        return area, second, twist
    inner = _solid(section.shape, outer - 2.0 * section.wall)
    if section.shape == "ellipse":
        return area - inner[0], second - inner[1], twist - inner[2]
    middle = outer - section.wall  # closed thin-walled section, Bredt 1896
    bredt = 2.0 * section.wall * middle.prod(axis=-1) ** 2 / middle.sum(axis=-1)
    return area - inner[0], second - inner[1], bredt


def _solid(shape: str, size: Array) -> tuple[Array, Array, Array]:
    """See `_moments`; torsion as Saint-Venant 1855."""
    first, second = size[..., 0], size[..., 1]
    if shape == "ellipse":
        area = 0.25 * math.pi * first * second
        twist = math.pi / 16.0 * (first * second) ** 3 / (first**2 + second**2)
        return area, area[..., None] * size**2 / 16.0, twist
    area, narrow, wide = first * second, np.minimum(first, second), np.maximum(first, second)
    odd = np.arange(1, 40, 2)
    series = (np.tanh(0.5 * math.pi * odd * (wide / narrow)[..., None]) / odd**5).sum(axis=-1)
    twist = wide * narrow**3 / 3.0 * (1.0 - 192.0 / math.pi**5 * narrow / wide * series)
    return area, area[..., None] * size**2 / 12.0, twist


def _gyration(section: RodSectionDescription, along: Array) -> Array:
    """Radii of gyration along both axes in [m], shape (..., 2)."""
    area, second, _ = _moments(section, along)
    return np.asarray(np.sqrt(second / area[..., None]))


def _stiffness(section: RodSectionDescription, along: Array, moduli: Array) -> tuple[Array, Array]:
    """Area in [m^2], shape (...), and stiffness over the moduli, shape (..., 6, 6); see RodSections."""
    area, second, twist = _moments(section, along)
    carrying = SHEAR_SHARE[section.shape] * area
    line = np.zeros((*along.shape, 6, 6))
    for k, each in enumerate((area, carrying, carrying, second[..., 0], second[..., 1], twist)):
        line[..., k, k] = each
    if section.stiffness is not None:
        start = _moments(section, np.zeros(()))
        taper = [area / start[0]] * 3 + [second[..., k] / start[1][k] for k in (0, 1)] + [twist / start[2]]
        for k, (given, ratio) in enumerate(zip(section.stiffness, taper, strict=True)):
            line[..., k, k] = given / moduli[k] * ratio
    if section.layers:
        shares = np.array([each.share for each in section.layers])
        ratios = np.array([each.modulus_ratio for each in section.layers])
        thick, wide = (_sizes(section, along)[..., k] for k in (0, 1))
        edges = np.concatenate([[0.0], np.cumsum(shares)]) / shares.sum() - 0.5
        for power, (k, m) in enumerate(((0, 0), (0, 3), (3, 3)), start=1):
            part = (ratios * np.diff(edges**power)).sum() / power
            line[..., k, m] = line[..., m, k] = part * wide * thick**power
        mean = float((ratios * shares).sum())
        for k in (1, 2, 4, 5):
            line[..., k, k] *= mean
    return area, line


_RING = 2.0 * math.pi * np.arange(ROUND) / ROUND
_OUTLINES = {
    "rectangle": np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]),
    "ellipse": np.column_stack([np.cos(_RING), np.sin(_RING)]),
}
