"""Compilation of a scene's deformable bodies: cells by material, layers, fibres, rods."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from softsim_core.base import Array, IndexArray, SceneError, known_names
from softsim_core.physics.fem import ElementGroup, fibre_group, layer_group, volume_shares
from softsim_core.physics.fem.elements import TRI3, TRI6, Element
from softsim_core.physics.fem.materials import FIBRES, MEMBRANE, SECTION
from softsim_core.physics.fem.rods import CIRCLE, RodSections
from softsim_core.physics.mesh import (
    Embedding,
    RodMesh,
    SurfaceMesh,
    SweptMesh,
    TetMesh,
    along_curve,
    boundary_faces,
    carried_axes,
    cell_middles,
    place,
    rod_mesh,
    rotation_matrix,
    swept_mesh,
)
from softsim_core.scene import (
    AxisDescription,
    BodyDescription,
    FibresDescription,
    LayerDescription,
    MaterialDescription,
    MaterialRegionDescription,
    RodClampDescription,
    RodDescription,
    RodSectionDescription,
    SceneDescription,
    nodes_in,
)


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A body within the model: its nodes and elements are contiguous.

    Attributes:
        name: Name of the body.
        nodes: Slice of the model's nodes.
        mesh: Its tetrahedra, or the sections of a rod, with its own node numbers.
        boundary: Boundary triangles with the model's node numbers, shape (k, 3).
        surface: Visual surface at rest.
        embedding: Weights with which the visual surface follows the body's nodes.
        sections: Stiffness of the sections of a rod; None: it is no rod.
        unloaded: Positions of the nodes of its tetrahedra without load in [m], shape (n, 3); None: as in
            `mesh`.
        ends: Nodes of the ends of a slender body, with its own numbers; None: it has none.
        blocks: Nodes of its cells by the name of their element, or of those of a rod by the name "rod", with
            its own node numbers, shapes (m, a).
        cell_of_tet: The cell, counted through `blocks`, that each tetrahedron of its mesh is or is a part of,
            shape (t,).
    """

    name: str
    nodes: slice
    mesh: TetMesh | RodMesh
    boundary: IndexArray
    surface: SurfaceMesh
    embedding: Embedding
    sections: RodSections | None = None
    unloaded: Array | None = None
    ends: tuple[IndexArray, IndexArray] | None = None
    blocks: Mapping[str, IndexArray] = field(default_factory=dict)
    cell_of_tet: IndexArray = field(default_factory=lambda: np.zeros(0, np.int64))

    @property
    def cell_count(self) -> int:
        """Number of its cells."""
        return sum(map(len, self.blocks.values()))

    @property
    def outside(self) -> SurfaceMesh:
        """Surface for contact at rest: the boundary of its tetrahedra, or the surface of a rod."""
        if isinstance(self.mesh, RodMesh):
            return self.surface
        return SurfaceMesh(self.mesh.points, self.boundary - self.nodes.start, self.name)

    @property
    def solid(self) -> TetMesh:
        """Tetrahedra to which points are bound: its cells, or those between the nodes of a rod."""
        return self.mesh.solid if isinstance(self.mesh, RodMesh) else self.mesh

    @property
    def region_points(self) -> Array:
        """Rest position in [m] of each node for regions; for a rod, the centre of its section."""
        return self.mesh.region_points if isinstance(self.mesh, RodMesh) else self.mesh.points


def material_parts(
    description: BodyDescription, body: Body
) -> Iterator[tuple[str, MaterialDescription, IndexArray]]:
    """Yield owner in SceneDescription.materials, material and cells of the body, then of each of its regions.

    Cells are counted through the body's blocks.

    Raises:
        SceneError: a region has no cell, shares one with another region, or leaves none to the body.
    """
    owner = np.full(body.cell_count, -1)
    for k, region in enumerate(description.regions):
        inside = _cells_in(region, description, body)
        if len(inside) == 0:
            low, high = body.mesh.points.min(axis=0), body.mesh.points.max(axis=0)
            raise SceneError(
                f"material region {region.name} of body {description.name}: no cell's middle lies inside it; "
                f"move or enlarge it (the body spans {low} to {high} m)"
            )
        shared = owner[inside]
        if (shared >= 0).any():
            other = description.regions[int(shared.max())].name
            raise SceneError(
                f"body {description.name}: material regions {other} and {region.name} share "
                f"{int((shared >= 0).sum())} cells; move or shrink one of them"
            )
        owner[inside] = k
    if not (owner < 0).any():
        raise SceneError(
            f"body {description.name}: its material regions cover it whole; make one of them its `material`"
        )
    yield description.name, description.material, np.flatnonzero(owner < 0)
    for k, region in enumerate(description.regions):
        yield f"{description.name}.{region.name}", region.material, np.flatnonzero(owner == k)


def _cells_in(region: MaterialRegionDescription, description: BodyDescription, body: Body) -> IndexArray:
    if region.group is not None:
        groups = body.mesh.cell_groups if isinstance(body.mesh, TetMesh) else {}
        if region.group not in groups:
            raise SceneError(
                f"material region {region.name} of body {description.name}: its mesh has no group of volumes "
                f"{region.group!r}; {known_names(region.group, groups, 'it has')}"
            )
        return np.unique(body.cell_of_tet[groups[region.group]])
    shape = region.box or region.sphere
    assert shape is not None  # checked by the description
    middles = [cell_middles(body.mesh.points, cells) for cells in body.blocks.values()]
    return nodes_in(shape, np.concatenate(middles))


def _join_groups(groups: Sequence[ElementGroup], first_number: int) -> tuple[ElementGroup, ...]:
    """Return a group for each pair of element and law, with cells numbered from `first_number`."""
    found: dict[tuple[str, str], list[ElementGroup]] = {}
    for group in groups:
        found.setdefault((group.element.name, group.material.name), []).append(group)
    joined = []
    for parts in found.values():
        arrays: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in ("cells", "weights", "gradients", "body", "parameter_set")
        }
        numbers = first_number + np.arange(len(arrays["cells"]))
        first_number += len(numbers)
        joined.append(
            ElementGroup(parts[0].element, parts[0].material, numbers=numbers, fills=False, **arrays)
        )
    return tuple(joined)


def reinforcements(
    scene: SceneDescription, bodies: Sequence[Body], filling: Sequence[ElementGroup], rest: Array
) -> tuple[tuple[ElementGroup, ...], Array]:
    """Return the groups of all layers and fibres, and the nodal masses of layers in [kg], shape (n,).

    The bodies are filled by the groups `filling`; `rest` are all nodes at rest in [m], shape (n, 3).

    Raises:
        SceneError: one covers nothing.
    """
    parts, mass = list[ElementGroup](), np.zeros(len(rest))
    owners = [owner for owner, _ in scene.materials]
    for b, (body, description) in enumerate(zip(bodies, scene.bodies, strict=True)):
        for each in description.reinforcements:
            number = owners.index(f"{description.name}.{each.name}")
            if isinstance(each, LayerDescription):
                group = _layer(each, description, body, b, number, rest)
                mass += each.density * volume_shares(group, len(rest))
                parts.append(group)
            else:
                parts += _fibres(each, description, b, number, filling, rest)
    return _join_groups(parts, sum(len(group.cells) for group in filling)), mass


def _layer(
    layer: LayerDescription, description: BodyDescription, body: Body, b: int, number: int, rest: Array
) -> ElementGroup:
    faces = boundary_faces(body.solid)
    region = layer.box or layer.sphere
    assert region is not None  # checked by the description
    inside = np.isin(faces, nodes_in(region, body.solid.points)).all(axis=1)
    faces = faces[inside] + body.nodes.start
    if not len(faces):
        low, high = body.solid.points.min(axis=0), body.solid.points.max(axis=0)
        raise SceneError(
            f"layer {layer.name} of body {description.name}: no face of the body lies inside its region; "
            f"move or enlarge it (the body spans {low} to {high} m)"
        )
    one = np.ones(len(faces), dtype=np.int64)
    element: Element = TRI6 if faces.shape[1] == 6 else TRI3
    thickness = np.full(len(faces), layer.thickness)
    return layer_group(element, MEMBRANE, rest, faces, thickness, b * one, 0 * one, number * one)


def _fibres(
    fibres: FibresDescription,
    description: BodyDescription,
    b: int,
    number: int,
    filling: Sequence[ElementGroup],
    rest: Array,
) -> list[ElementGroup]:
    """Return the fibres in the cells of a body, a group for each element and law of these."""
    found = []
    for group in filling:
        own = np.flatnonzero(group.body == b)
        region = fibres.box or fibres.sphere
        if region is not None:
            own = own[nodes_in(region, rest[group.cells[own]].mean(axis=1))]
        if fibres.radii is not None:
            assert fibres.around is not None  # checked by the description
            along = np.array(fibres.around.direction) / np.linalg.norm(fibres.around.direction)
            arms = rest[group.cells[own]].mean(axis=1) - np.array(fibres.around.through)
            distance = np.linalg.norm(np.cross(along, arms), axis=1)
            own = own[(fibres.radii[0] <= distance) & (distance <= fibres.radii[1])]
        if len(own):
            part = group.part(own)
            axes = _axes(_directions(fibres, description.name, part, rest))
            found.append(fibre_group(part, FIBRES, rest, axes, np.full(len(own), number)))
    if not found:
        raise SceneError(
            f"fibres {fibres.name} of body {description.name}: no cell of the body has its middle inside "
            "their region or radii; move or enlarge them"
        )
    return found


def _directions(fibres: FibresDescription, body: str, group: ElementGroup, rest: Array) -> Array:
    """Return unit vectors along the fibres at the points of a group, shape (m, q, 3)."""
    if fibres.direction is not None:
        direction = np.array(fibres.direction, dtype=float)
        return np.broadcast_to(direction / np.linalg.norm(direction), (*group.weights.shape, 3))
    axis = fibres.around
    assert isinstance(axis, AxisDescription)  # checked by the description
    along = np.array(axis.direction, dtype=float)
    along /= np.linalg.norm(along)
    circle = np.cross(along, _places(group, rest) - np.array(axis.through))
    radius = np.linalg.norm(circle, axis=-1, keepdims=True)
    if not (radius > 1e-9).all():
        raise SceneError(
            f"fibres {fibres.name} of body {body}: their axis goes through a point of a cell, where they "
            "have no direction; move it or give them a region around it"
        )
    angle = np.radians(fibres.angle_deg)
    return np.asarray(np.cos(angle) * circle / radius + np.sin(angle) * along)


def _places(group: ElementGroup, rest: Array) -> Array:
    """Return positions in [m] of the points of a group's cells, shape (m, q, 3), with straight cells."""
    nodes = group.element.reference
    from_nodes = np.linalg.pinv(np.column_stack([nodes, np.ones(len(nodes))]))
    points = group.element.points
    weights = np.column_stack([points, np.ones(len(points))]) @ from_nodes
    return np.asarray(weights @ rest[group.cells])


def _axes(directions: Array) -> Array:
    """Return rotations whose first column is a direction (..., 3), shape (..., 3, 3)."""
    away = np.zeros_like(directions)
    np.put_along_axis(away, np.abs(directions).argmin(axis=-1)[..., None], 1.0, axis=-1)
    second = np.cross(directions, away)
    second /= np.linalg.norm(second, axis=-1, keepdims=True)
    return np.stack([directions, second, np.cross(directions, second)], axis=-1)


SHEAR_SHARE = {"rectangle": 5.0 / 6.0, "ellipse": 0.9}
"""Part of the area that carries shear, by shape of the section."""

ROUND = 12
"""Number of corners of an ellipse's outline, for surfaces."""

CLAMP_SHARE = 1e-3
"""Length of a compliant clamp over that of its rod."""

STIFFER = 10.0
"""Stiffness of the rigid parts of a clamp over that of the rod at the same length."""

_GAUSS = 0.5 + np.array([-0.5, 0.5]) / math.sqrt(3.0)


def draw_rod(rod: RodDescription, name: str, values: Mapping[str, float]) -> tuple[RodMesh, RodSections]:
    """Return start positions and stiffness of the sections of a rod.

    `name` is for messages; `values` are the parameters of its material, which has the law `rod`.

    Raises:
        MeshError: its centreline or first axis cannot be used.
    """
    moduli, holding = (each[0] for each in SECTION.scales(np.array([list(values.values())])))
    centres, axes, length = _lay_out_rod(rod, name)
    at_points = (np.arange(rod.elements)[:, None] + _GAUSS) / rod.elements
    at_sections = (np.arange(rod.elements)[:, None] + np.array([0.0, 0.5, 1.0])) / rod.elements
    area, line = _stiffness(rod.section, at_points, moduli)
    area_at_sections, _ = _stiffness(rod.section, at_sections, moduli)
    line *= _stiffness_factors(rod, at_points)[..., None, None]
    across = (area_at_sections * _stiffness_factors(rod, at_sections))[..., None, None] * np.eye(3)
    sections = RodSections(
        lengths=np.full(rod.elements, length / rod.elements),
        area=area,
        line=line,
        across=across,
        curvature=np.broadcast_to(np.array(rod.curvature, dtype=float), (rod.elements, 3)),
        straight=np.full(rod.elements, rod.natural == "straight"),
        own=np.zeros(rod.elements, dtype=np.bool_),
        reach=0.5 * _sizes(rod.section, at_points.mean(axis=1)),
    )
    along = np.linspace(0.0, 1.0, len(centres))
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
    area, second, _ = _moments(rod.section, along)
    spread = np.sqrt(second / area[..., None])[:, None] * CIRCLE  # radii of gyration along both axes
    outlines = 0.5 * _sizes(rod.section, along)[:, None] * _OUTLINES[rod.section.shape]
    return rod_mesh(centres, axes, spread, outlines, name), sections


def draw_tetrahedra(rod: RodDescription, name: str, order: int) -> tuple[SweptMesh, Array]:
    """Return a rod of tetrahedra of order 1 or 2, and its nodes without load in [m], shape (n, 3).

    Raises:
        MeshError: its centreline or first axis cannot be used.
    """
    centres, axes, length = _lay_out_rod(rod, name)
    sizes = _sizes(rod.section, np.linspace(0.0, 1.0, len(centres)))
    swept = swept_mesh(centres, axes, sizes, length, rod.across, order, name)
    return swept, swept.straight if rod.natural == "straight" else swept.mesh.points


def _lay_out_rod(rod: RodDescription, name: str) -> tuple[Array, Array, float]:
    """Return centres and axes of the sections of a rod as drawn, and its length without load in [m]."""
    turn = rotation_matrix(rod.placement.rotation_deg)
    ends = [
        None if each is None else turn @ np.array(each, dtype=float)
        for each in (rod.start_direction, rod.end_direction)
    ]
    points = place(np.array(rod.centreline, dtype=float), rod.placement)
    centres, tangents, drawn = along_curve(points, 2 * rod.elements + 1, name, (ends[0], ends[1]))
    axes = carried_axes(tangents, turn @ np.array(rod.first_axis, dtype=float), name)
    return centres, axes, rod.length or drawn


def _with_clamp(
    sections: RodSections, clamp: RodClampDescription, end: int, length: float, moduli: Array, holding: Array
) -> RodSections:
    """Return sections with a further cell at an end (0 or -1) for a compliant clamp; see fem.rods."""
    gap, rigid = 0.5 * length, np.isinf(clamp.stiffness)
    beside = STIFFER * np.diagonal(sections.line[end, end] * np.sqrt(np.multiply.outer(moduli, moduli)))
    own = np.tile(np.diag(beside), (2, 1, 1))
    clamped = np.diag(np.where(rigid, beside, clamp.stiffness * gap))
    own[0, :3, :3], own[1, 3:, 3:] = clamped[:3, :3], clamped[3:, 3:]
    own[1, :3, :3] += beside[3:5].max() / gap**2 * np.eye(3)  # t carries moments as forces over the gap
    across = sections.across[end, end] * holding
    cell = RodSections(
        lengths=np.array([length]),
        area=np.tile(sections.area[end, end], (1, 2)),
        line=own[None],
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
    """Return the full extent in [m] along both axes at parts of the length, shape (..., 2)."""
    start, end = np.array(section.size), np.array(section.end_size or section.size)
    return np.asarray(start + along[..., None] * (end - start))


def _moments(section: RodSectionDescription, along: Array) -> tuple[Array, Array, Array]:
    """Return area, second moments along both axes and torsion constant of a section at parts of the length.

    They are in [m^2], [m^4] and [m^4], with shapes (...), (..., 2) and (...).
    """
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
    """Return area in [m^2], second moments in [m^4] and torsion constant in [m^4] of a solid section.

    The shapes are (...), (..., 2) and (...). The torsion constant follows Saint-Venant 1855.
    """
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


def _stiffness(section: RodSectionDescription, along: Array, moduli: Array) -> tuple[Array, Array]:
    """Return area (...) in [m^2] and stiffness over the moduli (..., 6, 6); see RodSections."""
    area, second, twist = _moments(section, along)
    carrying = SHEAR_SHARE[section.shape] * area
    line = np.zeros((*along.shape, 6, 6))
    for k, each in enumerate((area, carrying, carrying, second[..., 0], second[..., 1], twist)):
        line[..., k, k] = each
    if section.stiffness is not None:
        start = _moments(section, np.zeros(()))
        taper = [area / start[0]] * 3 + [second[..., k] / start[1][k] for k in (0, 1)] + [twist / start[2]]
        for k, (stiffness, ratio) in enumerate(zip(section.stiffness, taper, strict=True)):
            line[..., k, k] = stiffness / moduli[k] * ratio
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


def _stiffness_factors(rod: RodDescription, along: Array) -> Array:
    """Return the factors on the stiffness at parts of the length."""
    if not rod.stiffness_factors:
        return np.ones_like(along)
    shares, factors = np.array(rod.stiffness_factors).T
    return np.asarray(factors[np.searchsorted(shares[:-1], along)])


_RING = 2.0 * math.pi * np.arange(ROUND) / ROUND
_OUTLINES = {
    "rectangle": np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]),
    "ellipse": np.column_stack([np.cos(_RING), np.sin(_RING)]),
}
