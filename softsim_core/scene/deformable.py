"""Description of a deformable body: shape, material regions, mass, attachments; typed, SI."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

import numpy as np

from softsim_core.base import (
    DIRECTION,
    Array,
    Box,
    FieldError,
    IndexArray,
    MeshFile,
    Placement,
    SceneError,
    Sphere,
    Vector,
    listing,
    need_finite,
    need_positive,
)
from softsim_core.physics.fem.elements import element
from softsim_core.physics.fem.materials import SECTION
from softsim_core.physics.mechanics import rotation_euler
from softsim_core.physics.mesh import TetMesh
from softsim_core.scene.material import MaterialDescription
from softsim_core.scene.rod import FibresDescription, LayerDescription, RodDescription, RodEnd

SLACK_M = 1e-9
"""Tolerance in [m] for rounding at faces, which belong to a region."""


def nodes_in(region: Box | Sphere, points: Array) -> IndexArray:
    """Return ascending indices of the `points` (n, 3) inside a region, in the region's coordinates."""
    offset = points - np.array(region.center)
    if isinstance(region, Sphere):
        return np.flatnonzero(np.linalg.norm(offset, axis=1) <= region.radius + SLACK_M)
    local = offset @ rotation_euler(np.radians(region.rotation_deg))
    return np.flatnonzero((np.abs(local) <= np.array(region.size) / 2 + SLACK_M).all(axis=1))


def need_one_region(owner: str, *regions: Box | Sphere | RodEnd | str | None) -> None:
    """Raise SceneError unless exactly one of a region's box, sphere, end of a rod and group is given."""
    if sum(each is not None for each in regions) != 1:
        raise SceneError(f"{owner}: give exactly one of box, sphere, end and group")


@dataclass(frozen=True, slots=True, kw_only=True)
class AttachmentDescription:
    """A region of a body that moves rigidly: with the world, with a joint, or as a free rigid frame.

    Attributes:
        name: Unique name; also the name of a free frame.
        body: Name of the body.
        to: "world" (fixed), "free" (a rigid frame with six unknowns), the name of a joint, or the name of an
            attachment with to = free, whose frame then carries both.
        box, sphere: The region; nodes are chosen once, on the rest shape, for a rod as whole sections.
        end: Alternatively an end of a rod, beyond its clamp if it has one.
        group: Alternatively the name of a group of the mesh's file: a physical group of Gmsh, of points,
            lines, faces or cells. Give exactly one of the four.
        relative_to: None: the region is given in world coordinates. A joint name: in that joint's base frame.
        frame: Origin in [m] and orientation of a free frame, in world coordinates. None: the origin is the
            mean of its nodes at rest, the axes are those of the world.
        stiffness: Only with to = "world": spring in [N/m] per node instead of an exact fixing.
    """

    name: str
    body: str
    to: str
    box: Box | None = None
    sphere: Sphere | None = None
    end: RodEnd | None = None
    group: str | None = None
    relative_to: str | None = None
    frame: Placement | None = None
    stiffness: float | None = None

    def __post_init__(self) -> None:
        need_one_region(f"attachment {self.name}", self.box, self.sphere, self.end, self.group)
        if self.stiffness is not None and (self.to != "world" or not 0.0 < self.stiffness < math.inf):
            raise SceneError(f"attachment {self.name}: stiffness needs to = world and a value > 0 N/m")


@dataclass(frozen=True, slots=True, kw_only=True)
class MaterialRegionDescription:
    """Cells of a body with a different material, such as a bone or a softer skin.

    Attributes:
        name: Unique in its body.
        material: Law and parameters; the mass per volume is the body's.
        group: Name of a group of cells of the mesh's file: a physical group of volumes of Gmsh.
        box, sphere: Alternatively the cells with their middle inside, on the rest shape. Give exactly one of
            the three.
    """

    name: str
    material: MaterialDescription
    group: str | None = None
    box: Box | None = None
    sphere: Sphere | None = None

    def __post_init__(self) -> None:
        if sum(each is not None for each in (self.group, self.box, self.sphere)) != 1:
            raise SceneError(f"material region {self.name}: give exactly one of group, box and sphere")

    @property
    def values(self) -> Mapping[str, float]:
        """Parameters of its law by name."""
        return self.material.values

    def with_values(self, values: Mapping[str, float]) -> MaterialRegionDescription:
        """Return the same region with other values of its law."""
        return replace(self, material=self.material.with_values(**values))


MassDistribution: TypeAlias = Literal["volume", "consistent", "equal"]


@dataclass(frozen=True, slots=True, kw_only=True)
class AddedMassDescription:
    """Additional mass, spread evenly over the nodes of a region: a load, a sensor, a nut.

    Attributes:
        mass: In [kg], > 0.
        box, sphere: The region; nodes are chosen once, on the rest shape.
        end: Alternatively an end of a rod.
        group: Alternatively the name of a group of the mesh's file (a physical group of Gmsh). Give exactly
            one of the four.
    """

    mass: float
    box: Box | None = None
    sphere: Sphere | None = None
    end: RodEnd | None = None
    group: str | None = None

    def __post_init__(self) -> None:
        need_positive("added mass", "mass", self.mass, "kg")
        need_one_region("added mass", self.box, self.sphere, self.end, self.group)


@dataclass(frozen=True, slots=True, kw_only=True)
class BodyDescription:
    """A deformable body.

    Attributes:
        name: Unique name.
        mesh: Tetrahedra: a file, or arrays in [m]; or give `rod`.
        rod: A slender body; or give `mesh`. It has no layers, fibres, surface of its own or order. Its law is
            `rod`, or with an `element` of tetrahedra another one.
        material: Law and parameters.
        density: Mass per volume in [kg/m^3], > 0; or give `total_mass`. If neither is given, the density of
            the material's preset, if it is known.
        total_mass: Mass in [kg], > 0; or give `density`.
        mass_distribution: Distribution of the mass over the nodes. "volume": each element's mass goes to its
            nodes. "consistent": the mass matrix follows from the shape functions, so the inertia of a body
            with straight edges is exact. "equal": every node has the same mass, as in the reference
            simulator, which makes the inertia of coarse meshes much too large.
        added_masses: Additional masses of its parts.
        layers: Thin sheets on its faces.
        fibres: Embedded fibres, which carry tension only.
        regions: Parts of another material.
        velocity: Start velocity in [m/s] of all its nodes, except those that are fixed or follow a joint.
        surface: Finer visual surface that follows the body; None shows the boundary of the tetrahedra.
        colour: Red, green, blue, alpha in 0..1, for pictures only.
        order: 2 puts a node on each edge of a linear mesh, 1 removes those of a quadratic one; None: as in
            the mesh.
        element: Name of the element of its cells, see fem.elements, with the same number of nodes; None: tet4
            or tet10, hex8 for hexahedra without an `order`, or for a rod sections along it. With tet4 or
            tet10 the rod is a strip of tetrahedra of the same shape, and hexahedra are split.
    """

    name: str
    mesh: MeshFile | TetMesh | None = None
    rod: RodDescription | None = None
    material: MaterialDescription
    density: float | None = None
    total_mass: float | None = None
    mass_distribution: MassDistribution = "volume"
    added_masses: tuple[AddedMassDescription, ...] = ()
    layers: tuple[LayerDescription, ...] = ()
    fibres: tuple[FibresDescription, ...] = ()
    regions: tuple[MaterialRegionDescription, ...] = ()
    velocity: Vector = field(default=(0.0, 0.0, 0.0), metadata=DIRECTION)
    surface: MeshFile | None = None
    colour: tuple[float, float, float, float] = (0.9, 0.9, 0.9, 1.0)
    order: Literal[1, 2] | None = None
    element: str | None = None

    def __post_init__(self) -> None:
        owner = f"body {self.name}"
        need_finite(owner, "velocity", self.velocity)
        self._check_rod(owner)
        if self.density is None and self.total_mass is None:
            object.__setattr__(self, "density", self.material.known_density)
        if (self.density is None) == (self.total_mass is None):
            which = "neither" if self.density is None else "both"
            exactly = "give exactly one of `density` in kg/m^3 and `total_mass` in kg"
            raise SceneError(f"{owner}: {exactly}, not {which}")
        if self.density is not None:
            need_positive(owner, "density", self.density, "kg/m^3")
        if self.total_mass is not None:
            need_positive(owner, "total_mass", self.total_mass, "kg")
        if not all(0.0 <= channel <= 1.0 for channel in self.colour):
            raise FieldError(owner, "colour", list(self.colour), "four numbers in 0..1")
        names = [each.name for each in self.parts]
        if twice := {name for name in names if names.count(name) > 1}:
            raise SceneError(f"{owner}: layers, fibres and regions share the name {min(twice)}; rename one")

    def _check_rod(self, owner: str) -> None:
        if (self.mesh is None) == (self.rod is None):
            raise SceneError(f"{owner}: give exactly one of mesh and rod")
        if self.rod is None:
            if any(added.end is not None for added in self.added_masses):
                raise SceneError(f"{owner}: only a rod has an end; give the added mass a box or a sphere")
            if self.material.law == SECTION.name:
                raise SceneError(
                    f"{owner}: the law {SECTION.name} is for rods; choose another one, or give a rod"
                )
            return
        if self.element is not None:
            self._check_tetrahedra_of_rod(owner, self.rod, self.element)
        elif self.material.law is None and not self.material.terms:
            object.__setattr__(self, "material", self.material.of_law(SECTION.name))
        elif self.material.law != SECTION.name or self.material.terms:
            law = f"{self.material.law} with Prony terms" if self.material.terms else self.material.law
            raise SceneError(
                f"{owner}: a rod has the law {SECTION.name}, not {law}; remove `law` and `prony`, or make it "
                "of tetrahedra by `element: tet10`"
            )
        for name in ("layers", "fibres", "regions", "surface", "order"):
            if getattr(self, name):
                raise SceneError(f"{owner}: a rod takes no {name}; remove it, or give a mesh instead")

    def _check_tetrahedra_of_rod(self, owner: str, rod: RodDescription, cell: str) -> None:
        if len(element(cell).reference) not in (4, 10):
            raise SceneError(f"{owner}: a rod is not made of the element {cell}; take tet4 or tet10, or none")
        if self.material.law == SECTION.name:
            raise SceneError(
                f"{owner}: the law {SECTION.name} is for sections, and `element` makes tetrahedra of it; "
                "choose another law, or remove `element`"
            )
        if beyond := rod.beyond_tetrahedra:
            raise SceneError(
                f"{owner}: a rod of tetrahedra is a solid rectangle, straight or as drawn, without clamps "
                f"that give way; remove {listing(beyond)} or `element`"
            )

    @property
    def is_rod(self) -> bool:
        """Whether it consists of cross-sections, not of tetrahedra."""
        return self.rod is not None and self.element is None

    @property
    def reinforcements(self) -> tuple[LayerDescription | FibresDescription, ...]:
        """Its layers, then its fibres."""
        return (*self.layers, *self.fibres)

    @property
    def parts(self) -> tuple[LayerDescription | FibresDescription | MaterialRegionDescription, ...]:
        """Its parts with parameters of their own: layers, fibres, regions."""
        return (*self.reinforcements, *self.regions)
