"""From the description of a rod to its sections and how stiff they are."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from softsim_core.arrays import Array
from softsim_core.fem.materials.section import SECTION
from softsim_core.fem.rods import CIRCLE, RodSections
from softsim_core.mesh.placement import place, rotation_matrix
from softsim_core.mesh.rods import RodMesh, along_curve, carried_axes, rod_mesh
from softsim_core.mesh.swept import SweptMesh, swept_mesh
from softsim_core.scene.rod import RodClampDescription, RodDescription, RodSectionDescription

SHEAR_SHARE = {"rectangle": 5.0 / 6.0, "ellipse": 0.9}
"""Part of the area that carries shear."""

ROUND = 12
"""Corners of the outline of an ellipse, for surfaces."""

CLAMP_SHARE = 1e-3
"""Length of a compliant clamp over that of its rod."""

STIFFER = 10.0
"""How much stiffer the rigid parts of a clamp are than the rod of their length."""

_GAUSS = 0.5 + np.array([-0.5, 0.5]) / math.sqrt(3.0)


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
    centres, axes, length = _laid(rod, name)
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
    spread = _gyration(rod.section, along)[:, None] * CIRCLE
    outlines = 0.5 * _sizes(rod.section, along)[:, None] * _OUTLINES[rod.section.shape]
    return DrawnRod(rod_mesh(centres, axes, spread, outlines, name), sections)


def draw_tetrahedra(rod: RodDescription, name: str, order: int) -> tuple[SweptMesh, Array]:
    """Compile a rod that is tetrahedra of order 1 or 2: its mesh, and where its nodes are without load.

    Args:
        rod: The rod.
        name: Of its body, for messages.
        order: Of the tetrahedra.

    Returns:
        The mesh, and places in [m], shape (n, 3).

    Raises:
        MeshError: its centreline or first axis cannot be used.
    """
    centres, axes, length = _laid(rod, name)
    sizes = _sizes(rod.section, np.linspace(0.0, 1.0, len(centres)))
    swept = swept_mesh(centres, axes, sizes, length, rod.across, order, name)
    return swept, swept.straight if rod.natural == "straight" else swept.mesh.points


def _laid(rod: RodDescription, name: str) -> tuple[Array, Array, float]:
    """Centres and axes of the sections of a rod as it is drawn, and its length without load in [m]."""
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
    """With a further cell at an end, 0 or -1, for what gives way there; see fem.rods."""
    gap, rigid = 0.5 * length, np.isinf(clamp.stiffness)
    beside = STIFFER * np.diagonal(sections.line[end, end] * np.sqrt(np.multiply.outer(moduli, moduli)))
    own = np.tile(np.diag(beside), (2, 1, 1))
    given = np.diag(np.where(rigid, beside, clamp.stiffness * gap))
    own[0, :3, :3], own[1, 3:, 3:] = given[:3, :3], given[3:, 3:]
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
