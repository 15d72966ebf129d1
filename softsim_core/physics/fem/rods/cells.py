"""Cells of rods: sections, strains, energy, forces, stiffness, damping and stress."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np

from softsim_core.base import Array, BoolArray, IndexArray
from softsim_core.physics.fem import (
    ElementGroup,
    LinearMove,
    cauchy_stress,
    cell_energy,
    cell_forces,
    cell_stiffness,
)
from softsim_core.physics.fem.elements import ElementData
from softsim_core.physics.fem.materials import Section
from softsim_core.physics.mesh import RodMesh

R, D1, D2, B1, B2 = range(5)
"""Indices of a cell's vectors at a point: r', d_1, d_2, d_1', d_2'."""


def _forms(*entries: tuple[int, int, int, float], strains: int, vectors: int) -> Array:
    """Return matrices Q of products v^T Q_k v / 2, shape (strains, vectors, vectors)."""
    forms = np.zeros((strains, vectors, vectors))
    for k, f, g, value in entries:
        forms[k, f, g] = forms[k, g, f] = value
    return forms


LINE_FORMS: Final = _forms(
    (0, R, R, 1.0),
    (1, R, D1, 1.0),
    (2, R, D2, 1.0),
    (3, R, B1, 1.0),
    (4, R, B2, 1.0),
    (5, B1, D2, 0.5),
    (5, D1, B2, -0.5),
    strains=6,
    vectors=5,
)
SECTION_FORMS: Final = _forms((0, 0, 0, 1.0), (1, 1, 1, 1.0), (2, 0, 1, 1.0), strains=3, vectors=2)

SHORTEST: Final = 0.05
"""Lower limit of |r'|: a rod that is shorter has been crushed."""

BENDING: Final = (3, 4)
"""Indices of the bending strains among the strains along a rod."""


class Strains(NamedTuple):
    """Strains at points.

    Attributes:
        values: Shape (m, q, k).
        slopes: Derivatives of the strains by the products, shape (m, q, k, k).
    """

    values: Array
    slopes: Array


@dataclass(frozen=True, slots=True, eq=False)
class StrainPoints:
    """Points at which a cell's strains are evaluated; each cell has the same number of them.

    Attributes:
        maps: From the nodes of a cell to its vectors, shape (m, q, f, a).
        forms: Products of the vectors, shape (k, f, f); see `LINE_FORMS`.
        natural: Strains without load, shape (m, q, k).
        lengths: Weights in [m] of the points in the integral of the energy, shape (m, q).
        stiffness: Stiffness of the strains divided by the values of `Section.scales`, shape (m, q, k, k).
        along: Whether the strains are those along a rod; else they are the products themselves.
    """

    maps: Array
    forms: Array
    natural: Array
    lengths: Array
    stiffness: Array
    along: bool

    per_cell: ClassVar[Sequence[str]] = ("maps", "natural", "lengths", "stiffness")

    def part(self, chosen: IndexArray) -> StrainPoints:
        """Return the points of the chosen cells (k,) only."""
        each: dict[str, Any] = {name: getattr(self, name)[chosen] for name in self.per_cell}
        return replace(self, **each)

    def with_node_order(self, inside: IndexArray) -> StrainPoints:
        """Return the points with the nodes of each cell in another order, `inside`, shape (m, a)."""
        return replace(self, maps=np.take_along_axis(self.maps, inside[:, None, None, :], axis=3))

    @staticmethod
    def join(parts: Sequence[StrainPoints]) -> StrainPoints:
        """Return the points of all cells of several; their strains are of one kind."""
        each: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts]) for name in StrainPoints.per_cell
        }
        return replace(parts[0], **each)

    def vectors(self, nodal: Array, cells: IndexArray) -> Array:
        """Return the vectors for nodal values (n, 3), shape (m, q, f, 3)."""
        return np.asarray(self.maps @ nodal[cells][:, None])

    def products(self, vectors: Array, others: Array | None = None) -> Array:
        """Return v^T Q_k w / 2 for vectors v and w (m, q, f, 3), shape (m, q, k); None: w is v."""
        others = vectors if others is None else others
        between = vectors @ np.swapaxes(others, -1, -2)
        count = len(self.forms)
        return np.asarray(0.5 * between.reshape(*between.shape[:2], -1) @ self.forms.reshape(count, -1).T)

    def strains(self, products: Array) -> Strains:
        """Return the strains for products (m, q, k), less the natural ones, and their derivatives."""
        count = products.shape[-1]
        slopes = np.broadcast_to(np.eye(count), (*products.shape, count))
        if not self.along:
            return Strains(products - self.natural, slopes)
        values, slopes, by_length = products.copy(), slopes.copy(), 1.0 / _stretch_of(products)
        values[..., 0] = 1.0 / by_length
        slopes[..., 0, 0] = by_length
        for k in BENDING:
            values[..., k] *= by_length
            slopes[..., k, k] = by_length
            slopes[..., k, 0] = -products[..., k] * by_length**3
        return Strains(values - self.natural, slopes)

    def contract_second_derivatives(self, products: Array, resultants: Array) -> Array:
        """Return the second derivatives of the strains by the products, times resultants, (m, q, k, k)."""
        result = np.zeros((*products.shape, products.shape[-1]))
        if self.along:
            by_length = 1.0 / _stretch_of(products)
            result[..., 0, 0] = -resultants[..., 0] * by_length**3
            for k in BENDING:
                result[..., 0, 0] += 3.0 * resultants[..., k] * products[..., k] * by_length**5
                result[..., 0, k] = result[..., k, 0] = -resultants[..., k] * by_length**3
        return result

    def slopes(self, vectors: Array) -> Array:
        """Return the derivatives of the products by the nodes, shape (m, q, k, a, 3)."""
        by_vectors = self.forms @ vectors[:, :, None]
        return np.asarray(np.swapaxes(self.maps, -1, -2)[:, :, None] @ by_vectors)


def _stretch_of(products: Array) -> Array:
    """Return |r'| for products (m, q, 6), shape (m, q), at least SHORTEST."""
    return np.maximum(np.sqrt(2.0 * products[..., 0]), SHORTEST)


SECTIONS: Final = 3
"""Number of cross-sections of a cell: its ends and the one between them, in order along the rod."""

_ANGLES = 2.0 * np.pi * np.arange(3) / 3.0
CIRCLE: Final = np.sqrt(2.0) * np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])
"""Positions of a section's nodes along d_1 and d_2, in its radii of gyration, shape (3, 2)."""

_GAUSS = np.array([-1.0, 1.0]) / np.sqrt(3.0)
_SHARES = np.array([1.0, 4.0, 1.0]) / 6.0
_SHAPES = np.stack([0.5 * _GAUSS * (_GAUSS - 1.0), 1.0 - _GAUSS**2, 0.5 * _GAUSS * (_GAUSS + 1.0)], axis=1)
_SLOPES = np.stack([_GAUSS - 0.5, -2.0 * _GAUSS, _GAUSS + 0.5], axis=1)

STRAIGHT: Final = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
"""Values of the strains of a straight rod before the natural ones are subtracted."""

_STIFF_SECTION = np.array([0.5, 0.5, 0.0])

_REFERENCE = np.concatenate([np.column_stack([CIRCLE, np.full(3, z)]) for z in (-1.0, 0.0, 1.0)])


def _solid_slopes() -> Array:
    """Return the shape function derivatives by (a, b, xi) on the centre line, shape (2, 9, 3)."""
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
    """Cells of rods: an ElementGroup with the gradients of the solid on the centre line.

    Attributes:
        line: Stretch, shear, bending and twist at the Gauss points; see the package.
        sections: Strains of the sections' shape, at the three sections.
        own: Whether a cell's stiffness is independent of the law, as that of a clamp, shape (m,).
        reach: Largest distance of the sections from their centres along d_1 and d_2 in [m], shape (m, 2).
    """

    line: StrainPoints
    sections: StrainPoints
    own: BoolArray
    reach: Array

    per_cell: ClassVar[Sequence[str]] = (*ElementGroup.per_cell, "own", "reach")

    @property
    def short(self) -> BoolArray:
        """Which cells are far shorter than they are thick: the clamps, shape (m,)."""
        return self.own

    def part(self, chosen: IndexArray) -> RodGroup:
        """Return the group with the chosen cells (k,) only."""
        of_cells = {name: getattr(self, name)[chosen] for name in self.per_cell}
        return replace(self, **of_cells, line=self.line.part(chosen), sections=self.sections.part(chosen))

    def with_node_order(self, inside: IndexArray) -> RodGroup:
        """Return the group with the nodes of each cell in another order, `inside`, shape (m, a)."""
        line, sections = self.line.with_node_order(inside), self.sections.with_node_order(inside)
        return replace(self, **self.of_nodes(inside), line=line, sections=sections)

    def families(self, p: Array) -> tuple[tuple[StrainPoints, Array], tuple[StrainPoints, Array]]:
        """Return line and sections, each with its stiffness in [N], [N m] and [N m^2], shape (m, q, k, k)."""
        assert isinstance(self.material, Section)
        along, across = (np.where(self.own[:, None], 1.0, each) for each in self.material.scales(p))
        return _scale_stiffness(self.line, along), _scale_stiffness(self.sections, across)


def _scale_stiffness(points: StrainPoints, scales: Array) -> tuple[StrainPoints, Array]:
    """Return points and their stiffness for the moduli `scales` of the strains, shape (m, k)."""
    root = np.sqrt(scales)[:, None]
    return points, points.stiffness * root[..., None] * root[..., None, :]


@dataclass(frozen=True, slots=True, eq=False)
class RodSections:
    """Stiffness of a rod's cells, divided by the values of the law that `Section.scales` returns.

    Attributes:
        lengths: Length of each cell without strain in [m], shape (m,).
        area: Area at the Gauss points in [m^2], shape (m, 2).
        line: Of stretch, shear, bending and twist at the Gauss points, with areas, second moments and the
            torsion constant on its diagonal, shape (m, 2, 6, 6).
        across: Of the sections' shape at the three sections, with their areas, shape (m, 3, 3, 3).
        curvature: Curvature of the cell without load in [1/m] along both axes, and twist in [rad/m], beyond
            that of its natural shape, shape (m, 3).
        straight: Whether the natural shape is straight; else it is the drawn one, shape (m,).
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
    """Return the cells of a rod whose nodes begin at `first_node`.

    The other arguments are those of ElementGroup.
    """
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
    """Return the map from the nodes of a clamp's cell to its vectors, shape (2, 5, 9); see the package.

    `of_sections` (3, 3, 3) maps the nodes of each section to r, d_1, d_2; `gap` is between sections in [m].
    """
    whole = np.zeros((SECTIONS, 3, 9))
    for s in range(SECTIONS):
        whole[s, :, 3 * s : 3 * s + 3] = of_sections[s]
    outer, clamped, end = whole if at_start else whole[::-1]
    along = (1.0 if at_start else -1.0) / gap
    maps = np.zeros((2, 5, 9))
    maps[0, R], maps[1, R] = along * (end[0] - clamped[0]), along * (clamped[0] - outer[0])
    maps[:, [D1, D2]] = clamped[1:]
    maps[0, [B1, B2]] = along * (clamped[1:] - outer[1:])
    maps[1, [B1, B2]] = along * end[1:]
    return maps


def join_rods(groups: Sequence[RodGroup]) -> RodGroup:
    """Return the cells of several rods of one law as one group."""
    parts: dict[str, Any] = {
        name: np.concatenate([getattr(each, name) for each in groups]) for name in RodGroup.per_cell
    }
    line = StrainPoints.join([each.line for each in groups])
    return replace(
        groups[0], **parts, line=line, sections=StrainPoints.join([each.sections for each in groups])
    )


@cell_energy.register
def rod_energy(group: RodGroup, positions: Array, p: Array) -> Array:
    """Return the elastic energy of each cell of rods in [J], shape (m,)."""
    total = np.zeros(len(group.cells))
    for points, stiffness in group.families(p):
        strain, _ = points.strains(points.products(points.vectors(positions, group.cells)))
        total += 0.5 * np.einsum(
            "mq,mqk,mqkl,mql->m", points.lengths, strain, stiffness, strain, optimize=True
        )
    return total


@cell_forces.register
def rod_forces(group: RodGroup, positions: Array, p: Array) -> Array:
    """Return the forces of the cells of rods on their nodes in [N], shape (m, a, 3)."""
    total = np.zeros((*group.cells.shape, 3))
    for points, stiffness in group.families(p):
        vectors = points.vectors(positions, group.cells)
        strain, by_products = points.strains(points.products(vectors))
        resultants = points.lengths[..., None] * (stiffness @ strain[..., None])[..., 0]
        pulling = (resultants[..., None, :] @ by_products)[..., 0, :]
        total -= np.einsum("mqk,mqkai->mai", pulling, points.slopes(vectors))
    return total


@cell_stiffness.register
def rod_stiffness(
    group: RodGroup,
    positions: Array,
    p: Array,
    positive: bool = False,
    distant: bool = False,
    last: LinearMove | None = None,
    mean_share: float = 1.0,
) -> Array:
    """Return the stiffness -df_a/dx_b of each cell of rods in [N/m], shape (m, a, a, 3, 3).

    The arguments are those of fem.cells.cell_stiffness. The geometric part of a positive or distant stiffness
    contains only the resultants that stretch.
    """
    count, a = group.cells.shape
    total = np.zeros((count, a, a, 3, 3))
    for points, stiffness in group.families(p):
        vectors = points.vectors(positions, group.cells)
        slopes, products = points.slopes(vectors), points.products(vectors)
        strain, by_products = points.strains(products)
        if last is not None:  # the strain that the last linear solve found, to first order
            start, change = (points.vectors(each, group.cells) for each in last)
            before, slope = points.strains(points.products(start))
            strain = before + (slope @ (2.0 * points.products(start, change))[..., None])[..., 0]
        resultants = points.lengths[..., None] * (stiffness @ strain[..., None])[..., 0]
        pulling = (resultants[..., None, :] @ by_products)[..., 0, :]
        moduli = np.swapaxes(by_products, -1, -2) @ stiffness @ by_products
        moduli *= points.lengths[..., None, None]
        if (positive or distant) and last is None:
            stretches = np.diagonal(points.forms, axis1=1, axis2=2).any(axis=1)
            pulling = np.where(stretches, np.maximum(pulling, 0.0), 0.0)
        else:
            moduli += points.contract_second_derivatives(products, resultants)
        flat = slopes.reshape(*slopes.shape[:3], -1)
        elastic = (np.swapaxes(flat, -1, -2) @ (moduli @ flat)).sum(axis=1)
        total += elastic.reshape(count, a, 3, a, 3).swapaxes(2, 3)
        between = np.tensordot(pulling, points.forms, 1)
        turning = (np.swapaxes(points.maps, -1, -2) @ between @ points.maps).sum(axis=1)
        total += turning[..., None, None] * np.eye(3)
    return total


def rod_viscosity(group: RodGroup, positions: Array, p: Array) -> Array:
    """Return -df_a/dv_b of the law's damping in [N s/m], shape (m, a, a, 3, 3).

    It is positive, and zero for rotations.
    """
    assert isinstance(group.material, Section)
    count, a = group.cells.shape
    total = np.zeros((count, 3 * a, 3 * a))
    damping = group.material.damping(p)[:, None, None, None]
    for points, stiffness in group.families(p):
        by_places = _by_places(points, group, positions)
        weighted = points.lengths[..., None, None] * stiffness
        total += (np.swapaxes(by_places, -1, -2) @ (damping * weighted) @ by_places).sum(axis=1)
    return total.reshape(count, a, 3, a, 3).swapaxes(2, 3)


def rod_drag(group: RodGroup, before: Array, positions: Array, p: Array, dt: float) -> Array:
    """Return the damping forces in [N] for the change of strain from `before` within dt, shape (m, a, 3)."""
    assert isinstance(group.material, Section)
    total = np.zeros((*group.cells.shape, 3))
    damping = group.material.damping(p)[:, None, None]
    for points, stiffness in group.families(p):
        old, new = (
            points.strains(points.products(points.vectors(at, group.cells))).values
            for at in (before, positions)
        )
        resultants = damping * points.lengths[..., None] * (stiffness @ ((new - old) / dt)[..., None])[..., 0]
        by_places = _by_places(points, group, positions)
        total -= np.einsum("mqk,mqkc->mc", resultants, by_places).reshape(total.shape)
    return total


def _by_places(points: StrainPoints, group: RodGroup, positions: Array) -> Array:
    """Return the derivatives of the strains by the positions of a cell's nodes, shape (m, q, k, 3 a)."""
    vectors = points.vectors(positions, group.cells)
    slopes = points.slopes(vectors)
    return points.strains(points.products(vectors)).slopes @ slopes.reshape(*slopes.shape[:3], -1)


@cauchy_stress.register
def rod_stress(group: RodGroup, positions: Array, p: Array) -> Array:
    """Return the stress of the most stressed fibre in world axes in [Pa], with the shear there, (m, q, 3, 3).

    For clamps and for sections given by their stiffness, it is the stress that the drawn shape would have.
    """
    assert isinstance(group.material, Section)
    line, _ = group.material.scales(p)
    vectors = group.line.vectors(positions, group.cells)
    strain, _ = group.line.strains(group.line.products(vectors))
    reach = group.reach[:, None]
    bending = np.abs(strain[..., 3:5] * reach).sum(axis=-1)
    axial = line[:, None, 0] * (strain[..., 0] + np.where(strain[..., 0] < 0.0, -bending, bending))
    twisting = strain[..., 5] * reach.min(axis=-1)
    shear = line[:, 1, None] * np.hypot(np.hypot(strain[..., 1], strain[..., 2]), 2.0 * twisting)
    frame = vectors[..., :2, :] / np.linalg.norm(vectors[..., :2, :], axis=-1, keepdims=True)
    tangent, across = frame[..., 0, :], frame[..., 1, :]
    mixed = tangent[..., :, None] * across[..., None, :]
    return np.asarray(
        axial[..., None, None] * tangent[..., :, None] * tangent[..., None, :]
        + shear[..., None, None] * (mixed + np.swapaxes(mixed, -1, -2))
    )
