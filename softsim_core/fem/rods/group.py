"""Groups of cells of rods: how their nodes make sections, and sections vectors at points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from softsim_core.arrays import Array, BoolArray, IndexArray
from softsim_core.fem.elements.element import ElementData
from softsim_core.fem.group import ElementGroup
from softsim_core.fem.materials.section import Section
from softsim_core.fem.rods.strain_points import B1, B2, D1, D2, LINE_FORMS, SECTION_FORMS, R, StrainPoints
from softsim_core.mesh.rods import RodMesh

SECTIONS: Final = 3
"""Cross-sections of a cell: its ends and the one between them, in order along the rod."""

_ANGLES = 2.0 * np.pi * np.arange(3) / 3.0
CIRCLE: Final = np.sqrt(2.0) * np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])
"""Where the nodes of a section stand, in its radii of gyration along d_1 and d_2, shape (3, 2)."""

_GAUSS = np.array([-1.0, 1.0]) / np.sqrt(3.0)
_SHARES = np.array([1.0, 4.0, 1.0]) / 6.0
_SHAPES = np.stack([0.5 * _GAUSS * (_GAUSS - 1.0), 1.0 - _GAUSS**2, 0.5 * _GAUSS * (_GAUSS + 1.0)], axis=1)
_SLOPES = np.stack([_GAUSS - 0.5, -2.0 * _GAUSS, _GAUSS + 0.5], axis=1)

STRAIGHT: Final = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
"""Strains of a straight rod, before those that it has without load are taken away."""

_STIFF_SECTION = np.array([0.5, 0.5, 0.0])

_REFERENCE = np.concatenate([np.column_stack([CIRCLE, np.full(3, z)]) for z in (-1.0, 0.0, 1.0)])


def _solid_slopes() -> Array:
    """Derivatives of a cell's shape functions by its coordinates (a, b, xi) on the centre line, (2, 9, 3)."""
    across = np.linalg.pinv(np.column_stack([CIRCLE, np.ones(3)]))  # d_1, d_2, r of the nodes of a section
    result = np.zeros((2, 9, 3))
    for s in range(SECTIONS):
        nodes = slice(3 * s, 3 * s + 3)
        result[:, nodes, 0] = _SHAPES[:, s, None] * across[0]
        result[:, nodes, 1] = _SHAPES[:, s, None] * across[1]
        result[:, nodes, 2] = _SLOPES[:, s, None] * across[2]
    return result


ROD: Final = ElementData(
    name="rod",
    reference=_REFERENCE,
    points=np.column_stack([np.zeros((2, 2)), _GAUSS]),
    weights=np.ones(2),
    slopes=_solid_slopes(),
    edges=np.array([[0, 3], [1, 4], [2, 5], [3, 6], [4, 7], [5, 8], [0, 1], [1, 2], [2, 0]]),
    faces=np.zeros((0, 3), np.int64),
    shares=np.repeat(_SHARES / 3.0, 3),
)
"""Three nodes for each of three sections; F on the centre line has the columns d_1, d_2 and r'."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RodGroup(ElementGroup):
    """Cells of rods; as ElementGroup, with the gradients of the solid on the centre line.

    Attributes:
        line: Stretch, shear, bending and twist at the Gauss points; see the package.
        sections: What keeps the sections in shape, at the three of them.
        own: Whether the stiffness of a cell is its own whatever the law says, as that of a clamp, shape (m,).
        reach: How far the sections reach from their centres along d_1 and d_2 in [m], shape (m, 2).
    """

    line: StrainPoints
    sections: StrainPoints
    own: BoolArray
    reach: Array

    @property
    def short(self) -> BoolArray:
        """See ElementGroup."""
        return self.own

    def part(self, chosen: IndexArray) -> RodGroup:
        """See ElementGroup."""
        line, sections = self.line.part(chosen), self.sections.part(chosen)
        own, reach = self.own[chosen], self.reach[chosen]
        of_cells = {name: getattr(self, name)[chosen] for name in self.per_cell}
        return replace(self, **of_cells, line=line, sections=sections, own=own, reach=reach)

    def ordered(self, inside: IndexArray) -> RodGroup:
        """See ElementGroup."""
        line, sections = self.line.ordered(inside), self.sections.ordered(inside)
        return replace(self, **self.of_nodes(inside), line=line, sections=sections)

    def families(self, p: Array) -> tuple[tuple[StrainPoints, Array], tuple[StrainPoints, Array]]:
        """Line and sections, each with its stiffness in [N], [N m] and [N m^2], shape (m, q, k, k)."""
        assert isinstance(self.material, Section)
        along, across = (np.where(self.own[:, None], 1.0, each) for each in self.material.scales(p))
        return _scaled(self.line, along), _scaled(self.sections, across)


def _scaled(points: StrainPoints, scales: Array) -> tuple[StrainPoints, Array]:
    """Points, and their stiffness where the moduli of the strains are `scales`, shape (m, k)."""
    root = np.sqrt(scales)[:, None]
    return points, points.stiffness * root[..., None] * root[..., None, :]


@dataclass(frozen=True, slots=True, eq=False)
class RodSections:
    """How stiff the cells of a rod are, over the values of the law that `Section.scales` tells.

    Attributes:
        lengths: Length of each cell without strain in [m], shape (m,).
        area: Area at the Gauss points in [m^2], shape (m, 2).
        line: Of stretch, shear, bending and twist there: with areas, second moments and the torsion constant
            on its diagonal, shape (m, 2, 6, 6).
        across: Of what strains the sections, at the three of them: with their areas, shape (m, 3, 3, 3).
        curvature: Of the cell without load in [1/m] along both axes, and twist in [rad/m], beyond that of its
            natural shape, shape (m, 3).
        straight: Whether this is straight; else it is the one that is drawn, shape (m,).
        own: See RodGroup.
        reach: See RodGroup.
    """

    lengths: Array
    area: Array
    line: Array
    across: Array
    curvature: Array
    straight: BoolArray
    own: BoolArray
    reach: Array


def rod_group(
    mesh: RodMesh, sections: RodSections, law: Section, first_node: int, body: int, first_number: int
) -> RodGroup:
    """The cells of a rod whose nodes begin at `first_node`; the rest as in ElementGroup."""
    count = len(mesh.cells)
    inverse = np.linalg.inv(np.concatenate([np.ones((len(mesh.spread), 3, 1)), mesh.spread], axis=2))
    of_cells = inverse[mesh.cells[:, ::3] // 3]  # (m, 3, (r, d_1, d_2), 3)
    slopes = 2.0 / sections.lengths[:, None, None] * _SLOPES
    shapes = np.broadcast_to(_SHAPES, slopes.shape)
    maps = [
        np.einsum("mqs,msk->mqsk", along, of_cells[:, :, row]).reshape(count, 2, 9)
        for along, row in ((slopes, 0), (shapes, 1), (shapes, 2), (slopes, 1), (slopes, 2))
    ]
    across = np.zeros((count, 3, 2, 9))
    for s in range(SECTIONS):
        across[:, s, :, 3 * s : 3 * s + 3] = of_cells[:, s, 1:]
    line_maps, half = np.stack(maps, axis=2), 0.5 * sections.lengths[:, None]
    for cell in np.flatnonzero(sections.own).tolist():
        line_maps[cell] = _clamp_maps(of_cells[cell], float(half[cell, 0]), at_start=cell == 0)
    drawn = line_maps @ mesh.points[mesh.cells][:, None]
    nothing = np.zeros((count, 2, len(LINE_FORMS)))
    line = StrainPoints(line_maps, LINE_FORMS, nothing, np.repeat(half, 2, axis=1), sections.line, along=True)
    as_drawn = line.strains(line.products(drawn)).values
    natural = np.where(sections.straight[:, None, None], STRAIGHT, as_drawn)
    natural[..., 3:] += sections.curvature[:, None]
    shares = np.multiply.outer(sections.lengths, _SHARES)
    numbers = np.arange(count)
    return RodGroup(
        element=ROD,
        material=law,
        cells=mesh.cells + first_node,
        weights=half * sections.area,
        gradients=np.ascontiguousarray(np.swapaxes(line_maps[:, :, :3], 2, 3)),
        body=np.full(count, body),
        numbers=numbers + first_number,
        parameter_set=np.full(count, body),
        line=replace(line, natural=natural),
        sections=StrainPoints(
            across,
            SECTION_FORMS,
            np.broadcast_to(_STIFF_SECTION, (count, 3, 3)),
            shares,
            sections.across,
            along=False,
        ),
        own=sections.own,
        reach=sections.reach,
    )


def _clamp_maps(of_sections: Array, gap: float, at_start: bool) -> Array:
    """From the nodes of a clamp's cell to its vectors, shape (2, 5, 9); see the package.

    Args:
        of_sections: From the nodes of each section to r, d_1, d_2, shape (3, 3, 3).
        gap: Between sections, in [m].
        at_start: Whether the clamp is at the rod's start; then its own last section is the rod's.
    """
    whole = np.zeros((SECTIONS, 3, 9))
    for s in range(SECTIONS):
        whole[s, :, 3 * s : 3 * s + 3] = of_sections[s]
    outer, held, end = whole if at_start else whole[::-1]
    along = (1.0 if at_start else -1.0) / gap
    maps = np.zeros((2, 5, 9))
    maps[0, R], maps[1, R] = along * (end[0] - held[0]), along * (held[0] - outer[0])
    maps[:, [D1, D2]] = held[1:]
    maps[0, [B1, B2]] = along * (held[1:] - outer[1:])
    maps[1, [B1, B2]] = along * end[1:]
    return maps


def joined(groups: Sequence[RodGroup]) -> RodGroup:
    """The cells of several rods of one law."""
    parts: dict[str, Any] = {
        name: np.concatenate([getattr(each, name) for each in groups]) for name in RodGroup.per_cell
    }
    return replace(
        groups[0],
        **parts,
        line=StrainPoints.joined([each.line for each in groups]),
        sections=StrainPoints.joined([each.sections for each in groups]),
        own=np.concatenate([each.own for each in groups]),
        reach=np.concatenate([each.reach for each in groups]),
    )
