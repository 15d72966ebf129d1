r"""A tactile array: pressures on a grid of cells over a patch of a body's surface.

Contacts act on the vertices of the collision surface. The force :math:`f_v` on each, along the normals of
its contacts, is spread over the patch by the vertex's shape function :math:`\varphi_v` on the triangles
around it; the pressure of a cell C of area A is

.. math:: p_C = \frac1A \sum_v f_v \frac{\int_C \varphi_v}{\int \varphi_v}

so the sum of pressure times area over all cells is exactly the force on the patch. The integrals are over
the patch at rest, seen along the z axis of its box. On a rigid body, where a triangle may be as large as a
face, each contact presses on the cell in which it lies.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.sparse import csr_array

from softsim_core.base import Array, Box, FieldError, IndexArray, SceneError
from softsim_core.physics.dynamics import ContactReport
from softsim_core.physics.mechanics import rotation_euler
from softsim_core.physics.sensing.description import (
    ANY_BODY,
    Quantity,
    Scenery,
    SensorKind,
    SimulatedSensorDescription,
)
from softsim_core.physics.sensing.sensor import Sensor, StepObservation

_FINE = 4
"""Largest edge of the parts of a triangle in the integrals, as a fraction of a cell's edge."""
_MOST_CUTS = 512
_FLAT = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """Cells of equal size.

    Attributes:
        low: Corner of smallest coordinates in [m], shape (2,).
        edge: Edges of a cell in [m], shape (2,).
        rows: Cells along the second axis.
        columns: Cells along the first axis.
    """

    low: Array
    edge: Array
    rows: int
    columns: int

    @property
    def area(self) -> float:
        """Area of a cell in [m^2]."""
        return float(self.edge.prod())

    def cell(self, places: Array) -> IndexArray:
        """Return the cell, numbered row by row, that each place (..., 2) is in or nearest to, shape (...)."""
        column, row = np.moveaxis(np.floor((places - self.low) / self.edge).astype(np.int64), -1, 0)
        return np.asarray(row.clip(0, self.rows - 1) * self.columns + column.clip(0, self.columns - 1))


def grid_over(patch: IndexArray, points: Array, rows: int, columns: int) -> Grid | None:
    """Return a grid that covers triangles (m, 3) over points (v, 2) in [m]; None: they have no area.

    Rows are along the second axis, columns along the first one.
    """
    corners = points[patch]
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    if not _areas(corners).max() > _FLAT * float(np.linalg.norm(high - low)) ** 2:
        return None
    return Grid(low, (high - low) / (columns, rows), rows, columns)


def spread_over(patch: IndexArray, points: Array, grid: Grid) -> csr_array:
    """Return the share of a force on each vertex that falls on each cell, divided by the cell's area.

    The force is spread by the vertex's shape function on the triangles of the patch around it.

    Args:
        patch: Triangles, shape (m, 3).
        points: Positions of all vertices in the plane of the grid in [m], shape (v, 2).
        grid: Grid over the patch.

    Returns:
        Shares in [1/m^2], shape (rows columns, v).
    """
    corners = points[patch]
    sides = np.abs(np.roll(corners, -1, axis=1) - corners)
    cuts = np.ceil(_FINE * (sides / grid.edge).max(axis=(1, 2))).astype(int).clip(1, _MOST_CUTS)
    cells, vertices, values = [], [], []
    for count in np.unique(cuts).tolist():
        chosen, middles = np.flatnonzero(cuts == count), _middles(count)
        cell = grid.cell(np.einsum("qa,mai->mqi", middles, corners[chosen]))
        share = _areas(corners[chosen])[:, None, None] / len(middles) * middles[None]
        cells.append(np.repeat(cell[:, :, None], 3, axis=2).ravel())
        vertices.append(np.repeat(patch[chosen][:, None], len(middles), axis=1).ravel())
        values.append(share.ravel())
    entries = (np.concatenate(values), (np.concatenate(cells), np.concatenate(vertices)))
    spread = csr_array(entries, shape=(grid.rows * grid.columns, len(points)))
    whole = np.asarray(spread.sum(axis=0)).ravel() * grid.area
    spread.data /= np.where(whole > 0.0, whole, 1.0)[spread.indices]
    return spread


def _areas(corners: Array) -> Array:
    """Return the areas of triangles (m, 3, 2) in a plane, shape (m,)."""
    (x, y), (u, v) = (np.moveaxis(corners[:, k] - corners[:, 0], 1, 0) for k in (1, 2))
    return np.asarray(0.5 * np.abs(x * v - y * u))


def _middles(count: int) -> Array:
    """Return the centres of `count` squared equal parts of a triangle as weights of its corners, (q, 3)."""
    i, j = (each.ravel() for each in np.meshgrid(np.arange(count), np.arange(count), indexing="ij"))
    upward, downward = i + j < count, i + j < count - 1
    first = np.concatenate([i[upward] + 1.0 / 3.0, i[downward] + 2.0 / 3.0]) / count
    second = np.concatenate([j[upward] + 1.0 / 3.0, j[downward] + 2.0 / 3.0]) / count
    return np.column_stack([1.0 - first - second, first, second])


_MOST_CELLS = 65_536


@dataclass(frozen=True, slots=True, kw_only=True)
class TactileArrayDescription(SimulatedSensorDescription):
    """Contact pressures in [Pa] on a grid over a patch of a body's collision surface.

    The patch consists of the triangles with all corners in `box` at the start. The grid covers it along the
    axes of the box: columns along x, rows along y, each from the smallest coordinate on; the view is along z.

    Attributes:
        body: The body with the collision surface, deformable or rigid.
        box: Box around the patch, in the world at the start.
        rows: Cells along the y axis of the box, >= 1.
        columns: Cells along the x axis of the box, >= 1.
        noise: Standard deviation of a cell in [Pa].
        bias: Bias of all cells in [Pa].
    """

    kind: ClassVar[str] = "tactile"
    output_quantity: ClassVar[Quantity] = Quantity.PRESSURES
    named_parts: ClassVar[Mapping[str, str]] = {"body": ANY_BODY}
    body: str
    box: Box
    rows: int
    columns: int
    noise: float = 0.0
    bias: float = 0.0

    def check(self) -> None:
        """Refuse a grid without cells or with too many."""
        for field, value in (("rows", self.rows), ("columns", self.columns)):
            if value < 1:
                raise FieldError(self.owner, field, value, ">= 1")
        if self.rows * self.columns > _MOST_CELLS:
            raise FieldError(self.owner, "rows", self.rows, f"at most {_MOST_CELLS} / columns")


class TactileArray(Sensor):
    """An array on a surface that deforms; see the module.

    Args:
        described: Noise and bias of a cell.
        patch: Triangles of the patch, shape (m, 3).
        places: Positions of the vertices in the plane of the grid in [m], shape (v, 2).
        grid: Its cells.
        body: Number of the body.
    """

    def __init__(
        self, described: TactileArrayDescription, patch: IndexArray, places: Array, grid: Grid, body: int
    ) -> None:
        super().__init__(described.noise, described.bias)
        self._spread, self._grid, self._body = spread_over(patch, places, grid), grid, body

    def measure(self, observation: StepObservation) -> Array:
        """Return the pressures in [Pa], shape (rows, columns)."""
        vertices, weights, pressing = select_contacts(observation.contacts, self._body)
        forces = np.bincount(
            vertices.ravel(), (pressing[:, None] * weights).ravel(), minlength=self._spread.shape[1]
        )
        return np.asarray(self._spread @ forces).reshape(self._grid.rows, self._grid.columns)


class RigidTactileArray(Sensor):
    """An array on a rigid surface: each contact presses on the cell in which it lies; see TactileArray."""

    def __init__(
        self, described: TactileArrayDescription, patch: IndexArray, places: Array, grid: Grid, body: int
    ) -> None:
        super().__init__(described.noise, described.bias)
        self._patch = np.isin(np.arange(len(places)), patch)
        self._places, self._grid, self._body = places, grid, body

    def measure(self, observation: StepObservation) -> Array:
        """Return the pressures in [Pa], shape (rows, columns)."""
        vertices, weights, pressing = select_contacts(observation.contacts, self._body)
        pressing = np.where((self._patch[vertices] | (weights == 0.0)).all(axis=1), pressing, 0.0)
        cells = self._grid.cell(np.einsum("kc,kci->ki", weights, self._places[vertices]))
        shape = (self._grid.rows, self._grid.columns)
        forces = np.bincount(cells, pressing, minlength=shape[0] * shape[1])
        return np.asarray(forces / self._grid.area).reshape(shape)


def select_contacts(contacts: ContactReport, body: int) -> tuple[IndexArray, Array, Array]:
    """Return the contacts on a body: vertices of its surface (k, 3), weights (k, 3), normal forces (k,)."""
    along = np.maximum(np.einsum("ki,ki->k", contacts.forces, contacts.normals), 0.0)
    which, side = np.nonzero(contacts.bodies == body)
    corner = 3 * side[:, None] + np.arange(3)
    return contacts.vertices[which[:, None], corner], contacts.weights[which[:, None], corner], along[which]


def _build_tactile(described: TactileArrayDescription, scenery: Scenery) -> Sensor:
    surfaces = scenery.surfaces_of(described.body)
    if not surfaces:
        raise SceneError(
            f"{described.owner}: body {described.body} has no collision surface of triangles that can meet "
            "another; add one to `collisions`"
        )
    box = described.box
    axes = rotation_euler(np.radians(box.rotation_deg))
    local = (scenery.points - np.array(box.center)) @ axes
    inside = (np.abs(local) <= np.array(box.size) / 2 + 1e-9).all(axis=1)
    triangles = np.concatenate([each.triangles for each in surfaces])
    patch = triangles[inside[triangles].all(axis=1)]
    if not len(patch):
        corners = local[np.unique(triangles)]
        raise SceneError(
            f"{described.owner}: no triangle of a collision surface of body {described.body} lies inside its "
            f"box; move or enlarge it (they span {corners.min(axis=0).round(6).tolist()} to "
            f"{corners.max(axis=0).round(6).tolist()} m along its axes, from its centre)"
        )
    places, number = local[:, :2], scenery.body_names.index(described.body)
    grid = grid_over(patch, places, described.rows, described.columns)
    if grid is None:
        raise SceneError(
            f"{described.owner}: along the z axis of its box the patch has no area; turn the box by "
            "rotation_deg"
        )
    kind: type[TactileArray | RigidTactileArray] = RigidTactileArray
    if described.body in scenery.soft.meshes:
        kind = TactileArray
    return kind(described, patch, places, grid, number)


TACTILE = SensorKind(TactileArrayDescription, _build_tactile)
