r"""A tactile array: the pressures on a grid of cells over a patch of a body's surface.

Contacts act on the vertices of the collision surface. The force :math:`f_v` on each, along the normals of
its contacts, is spread over the patch by the vertex's shape function :math:`\varphi_v` on the triangles
around it; the pressure of a cell C of area A is

.. math:: p_C = \frac1A \sum_v f_v \frac{\int_C \varphi_v}{\int \varphi_v}

so the sum of pressure times area over all cells is the force on the patch, exactly. The integrals are over
the patch at rest, seen along the z axis of its box.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.sparse import csr_array

from softsim_core.arrays import Array, IndexArray
from softsim_core.errors import SceneError
from softsim_core.mechanics.pose import rotation_euler
from softsim_core.sensing.building import Scenery, SensorKind
from softsim_core.sensing.description import ANY_BODY, Reference, SimulatedSensorDescription
from softsim_core.sensing.sensor import Seen, Sensor
from softsim_core.values import Box, FieldError

_FINE = 4
"""Triangles are cut into parts of at most a cell's edge by this, for the integrals."""
_MOST_CUTS = 64
_MOST_CELLS = 65_536
_FLAT = 1e-12


@dataclass(frozen=True, slots=True, kw_only=True)
class TactileArrayDescription(SimulatedSensorDescription):
    """Pressures in [Pa] on a grid over a patch of a body's collision surface, as contacts press on it.

    The patch are the triangles with all corners in `box` at the start. The grid covers it along the axes of
    the box: columns along x, rows along y, each from the smallest coordinate on; it is seen along z.

    Attributes:
        body: The body, deformable or rigid, that has a collision surface.
        box: Where the patch is, in the world at the start.
        rows: Cells along the y axis of the box, >= 1.
        columns: Cells along its x axis, >= 1.
        noise: Standard deviation of a cell in [Pa].
        bias: Of all cells in [Pa].
    """

    kind: ClassVar[str] = "tactile"
    body: str
    box: Box
    rows: int
    columns: int
    noise: float = 0.0
    bias: float = 0.0

    def check(self) -> None:
        """See SimulatedSensorDescription."""
        for field, value in (("rows", self.rows), ("columns", self.columns)):
            if value < 1:
                raise FieldError(self.owner, field, value, ">= 1")
        if self.rows * self.columns > _MOST_CELLS:
            raise FieldError(self.owner, "rows", self.rows, f"at most {_MOST_CELLS} / columns")
        self.need_noise(noise=self.noise)
        self.need_bias(bias=self.bias)

    def references(self) -> tuple[Reference, ...]:
        """See SimulatedSensorDescription."""
        return (Reference("body", self.body, ANY_BODY),)


class TactileArray(Sensor):
    """See the module.

    Args:
        spread: Share of a normal force on each collision vertex that each cell feels, by the cell's area, in
            [1/m^2], shape (rows columns, v).
        shape: Rows and columns.
        body: Number of the body.
        noise, bias: Of a cell in [Pa].
    """

    def __init__(
        self, spread: csr_array, shape: tuple[int, int], body: int, noise: float, bias: float
    ) -> None:
        super().__init__(noise, bias)
        self._spread, self._shape, self._body = spread, shape, body

    def measure(self, seen: Seen) -> Array:
        """Pressures in [Pa], shape (rows, columns)."""
        touching = seen.contacts
        if not len(touching.points):
            return np.zeros(self._shape)
        pressing = np.maximum(np.einsum("ki,ki->k", touching.forces, touching.normals), 0.0)
        own = np.repeat(touching.bodies == self._body, 3, axis=1)
        shares = pressing[:, None] * np.where(own, touching.weights, 0.0)
        forces = np.bincount(touching.vertices.ravel(), shares.ravel(), minlength=self._spread.shape[1])
        return np.asarray(self._spread @ forces).reshape(self._shape)


def _built(described: TactileArrayDescription, scenery: Scenery) -> TactileArray:
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
        seen = local[np.unique(triangles)]
        raise SceneError(
            f"{described.owner}: no triangle of a collision surface of body {described.body} lies inside its "
            f"box; move or enlarge it (they span {seen.min(axis=0).round(6).tolist()} to "
            f"{seen.max(axis=0).round(6).tolist()} m along its axes, from its centre)"
        )
    spread = spread_over(patch, local[:, :2], described.rows, described.columns)
    if spread is None:
        raise SceneError(
            f"{described.owner}: along the z axis of its box the patch has no area; turn the box by "
            "rotation_deg"
        )
    number = scenery.body_names.index(described.body)
    shape = (described.rows, described.columns)
    return TactileArray(spread, shape, number, described.noise, described.bias)


def spread_over(patch: IndexArray, seen: Array, rows: int, columns: int) -> csr_array | None:
    """How cells of a grid share forces on vertices, by area; see TactileArray.

    Args:
        patch: Triangles, shape (m, 3).
        seen: Where all vertices are in the plane of the grid in [m], shape (v, 2).
        rows: Of the grid, which covers the patch, along the second axis.
        columns: Along the first axis.

    Returns:
        In [1/m^2], shape (rows columns, v); None: the patch has no area in this plane.
    """
    corners = seen[patch]
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    edge = (high - low) / (columns, rows)
    sides = np.roll(corners, -1, axis=1) - corners
    area = 0.5 * np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    if not area.max() > _FLAT * float(np.linalg.norm(high - low)) ** 2:
        return None
    cuts = np.ceil(_FINE * (np.abs(sides) / edge).max(axis=(1, 2))).astype(int).clip(1, _MOST_CUTS)
    cells, vertices, values = [], [], []
    for count in np.unique(cuts).tolist():
        chosen, middles = np.flatnonzero(cuts == count), _middles(count)
        places = np.einsum("qa,mai->mqi", middles, corners[chosen])
        column, row = np.moveaxis(np.floor((places - low) / edge).astype(int), 2, 0)
        cell = row.clip(0, rows - 1) * columns + column.clip(0, columns - 1)
        share = area[chosen][:, None, None] / len(middles) * middles[None]
        cells.append(np.repeat(cell[:, :, None], 3, axis=2).ravel())
        vertices.append(np.repeat(patch[chosen][:, None], len(middles), axis=1).ravel())
        values.append(share.ravel())
    entries = (np.concatenate(values), (np.concatenate(cells), np.concatenate(vertices)))
    spread = csr_array(entries, shape=(rows * columns, len(seen)))
    whole = np.asarray(spread.sum(axis=0)).ravel() * float(edge.prod())
    spread.data /= np.where(whole > 0.0, whole, 1.0)[spread.indices]
    return spread


def _middles(count: int) -> Array:
    """Centres of the `count` squared equal parts of a triangle, as shares of its corners, shape (q, 3)."""
    i, j = (each.ravel() for each in np.meshgrid(np.arange(count), np.arange(count), indexing="ij"))
    upward, downward = i + j < count, i + j < count - 1
    first = np.concatenate([i[upward] + 1.0 / 3.0, i[downward] + 2.0 / 3.0]) / count
    second = np.concatenate([j[upward] + 1.0 / 3.0, j[downward] + 2.0 / 3.0]) / count
    return np.column_stack([1.0 - first - second, first, second])


TACTILE = SensorKind(TactileArrayDescription, _built)
