"""Meshes along curves: rods with their cross-sections, and slender bodies of tetrahedra."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from softsim_core.base import Array, IndexArray, MeshError
from softsim_core.physics.mesh.embedding import Embedding
from softsim_core.physics.mesh.generators import box_mesh
from softsim_core.physics.mesh.types import SurfaceMesh, TetMesh, quadratic


@dataclass(frozen=True, slots=True, eq=False)
class SweptMesh:
    """A body with rectangular cross-sections along a curve.

    Attributes:
        mesh: Its tetrahedra along the curve.
        straight: Positions of its nodes in [m] in straight form, along x from the origin on, shape (n, 3).
        ends: Nodes of its first and of its last cross-section.
    """

    mesh: TetMesh
    straight: Array
    ends: tuple[IndexArray, IndexArray]


def swept_mesh(
    centres: Array, axes: Array, sizes: Array, length: float, across: tuple[int, int], order: int, name: str
) -> SweptMesh:
    """Return tetrahedra between cross-sections: boxes of six, mirrored from box to box as in `box_mesh`.

    Args:
        centres: Centres of 2 m + 1 cross-sections in [m], ends and middles of m boxes in order, shape
            (2 m + 1, 3).
        axes: Rotation of each: tangent, first and second axis, as columns, shape (2 m + 1, 3, 3).
        sizes: Full extent of each along both axes in [m], shape (2 m + 1, 2).
        length: Length of the straight form in [m].
        across: Boxes along the first and the second axis.
        order: 1, or 2 with nodes on the edges, which then also lie on the curve.
        name: Name of the mesh, for messages.
    """
    last = len(centres) - 1
    boxes = box_mesh((last, 2.0, 2.0), (last // 2, *across), (0.0, -1.0, -1.0), name)
    boxes = quadratic(boxes) if order == 2 else boxes
    section = np.rint(boxes.points[:, 0]).astype(np.int64)
    place = 0.5 * boxes.points[:, 1:] * sizes[section]
    drawn = centres[section] + np.einsum("nij,nj->ni", axes[section][..., 1:], place)
    straight = np.column_stack([length / last * section, place])
    ends = np.flatnonzero(section == 0), np.flatnonzero(section == last)
    return SweptMesh(replace(boxes, points=drawn), straight, ends)


NODES = 3
"""Nodes of a cross-section."""

BESIDE = 20.0
"""Largest distance beside a rod of a carried point, in heights of the tetrahedra between its nodes."""

_PRISM = np.array([[0, 1, 2, 3], [1, 4, 2, 3], [2, 4, 5, 3]])
"""Tetrahedra between a section, 0 to 2, and the next, 3 to 5."""

_FINE = 64
"""Pieces between two given points for the length of a curve."""


@dataclass(frozen=True, slots=True, eq=False)
class RodMesh:
    """Cross-sections of a rod in order, three nodes each, and cells of three sections.

    Attributes:
        points: Node positions in [m], shape (3 k, 3).
        cells: Nodes of each cell, section by section, shape (m, 9).
        centres: Centres of the sections in [m], shape (k, 3).
        axes: Rotation of each section: tangent, first and second axis, as columns, shape (k, 3, 3).
        outlines: Corners of each section along its first and second axis in [m], in a sense of rotation about
            the tangent, shape (k, v, 2).
        spread: Positions of the nodes of each section along these axes in [m], shape (k, 3, 2).
        name: Name of the mesh, for messages.
    """

    points: Array
    cells: IndexArray
    centres: Array
    axes: Array
    outlines: Array
    spread: Array
    name: str = "rod"

    @property
    def region_points(self) -> Array:
        """Position of each node when a region chooses nodes: the centre of its section, shape (3 k, 3)."""
        return np.repeat(self.centres, NODES, axis=0)

    def end_nodes(self, start: bool) -> IndexArray:
        """Return the nodes of the first or of the last section, shape (3,)."""
        return np.arange(NODES) + (0 if start else len(self.points) - NODES)

    @property
    def solid(self) -> TetMesh:
        """The linear tetrahedra between its nodes, three between two sections, to bind points to."""
        start = NODES * np.arange(len(self.centres) - 1)[:, None, None]
        tets = (start + _PRISM).reshape(-1, 4)
        return TetMesh(self.points, tets.astype(np.int64), self.name, around=BESIDE)


def rod_mesh(centres: Array, axes: Array, spread: Array, outlines: Array, name: str = "rod") -> RodMesh:
    """Return a mesh of k = 2 m + 1 sections; see RodMesh."""
    points = centres[:, None] + spread @ np.swapaxes(axes[..., 1:], 1, 2)
    first = 2 * NODES * np.arange((len(centres) - 1) // 2)
    cells = first[:, None] + np.arange(3 * NODES)
    return RodMesh(points.reshape(-1, 3), cells.astype(np.int64), centres, axes, outlines, spread, name)


def along_curve(
    points: Array,
    count: int,
    name: str = "rod",
    directions: tuple[Array | None, Array | None] = (None, None),
) -> tuple[Array, Array, float]:
    """Return points and tangents at even distances along the smooth curve through points, and its length.

    The curve is a cubic spline; through two points, without directions at its ends, it is straight.

    Args:
        points: Points of the curve in [m], shape (p, 3), p >= 2.
        count: Number of points to return, ends included.
        name: Name of the mesh, for messages.
        directions: Unit tangents at the start and at the end, shape (3,); None: they follow from the points.

    Returns:
        Points in [m], shape (count, 3), unit tangents, shape (count, 3), and the length in [m].

    Raises:
        MeshError: two points in a row coincide, or are too near for the length of the whole.
    """
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if len(points) < 2 or not (np.isfinite(steps).all() and (steps > 0.0).all()):
        raise MeshError(name, "needs two or more points of its centreline, none of them twice in a row")
    from scipy.interpolate import CubicSpline  # late: only scenes with rods need it

    chords = _increasing(steps, name)
    if len(points) == 2 and directions[0] is None and directions[1] is None:
        even = np.linspace(0.0, 1.0, count)[:, None]
        tangent = (points[1] - points[0]) / chords[-1]
        return points[0] + even * (points[1] - points[0]), np.tile(tangent, (count, 1)), float(chords[-1])
    ends = tuple("not-a-knot" if each is None else (1, each) for each in directions)
    if len(points) < 4:  # too few for a third derivative without a jump
        ends = tuple((2, np.zeros(3)) if each == "not-a-knot" else each for each in ends)
    spline = CubicSpline(chords, points, bc_type=ends)
    fine = np.interp(np.arange(_FINE * (len(points) - 1) + 1) / _FINE, np.arange(len(points)), chords)
    speeds = np.linalg.norm(spline(fine, 1), axis=1)
    middle = np.linalg.norm(spline(0.5 * (fine[1:] + fine[:-1]), 1), axis=1)
    pieces = np.diff(fine) / 6.0 * (speeds[1:] + 4.0 * middle + speeds[:-1])
    lengths = _increasing(pieces, name)
    at = CubicSpline(lengths, fine)(np.linspace(0.0, lengths[-1], count))
    tangents = spline(at, 1)
    return spline(at), tangents / np.linalg.norm(tangents, axis=1, keepdims=True), float(lengths[-1])


def _increasing(pieces: Array, name: str) -> Array:
    """Return the lengths up to each point of a line, (p + 1,), from the lengths of its pieces, (p,)."""
    lengths = np.concatenate([[0.0], np.cumsum(pieces)])
    if not (np.diff(lengths) > 0.0).all():
        raise MeshError(name, f"has points of its centreline too near for its length of {lengths[-1]:.3g} m")
    return lengths


def carried_axes(tangents: Array, first_axis: Array, name: str = "rod") -> Array:
    """Return section axes with the least rotation about the tangent, shape (k, 3, 3); see RodMesh.axes.

    Args:
        tangents: Unit tangents at the sections, shape (k, 3).
        first_axis: Approximate first axis of the first section, shape (3,).
        name: Name of the mesh, for messages.

    Raises:
        MeshError: `first_axis` is along the tangent, or the curve reverses between two sections.
    """
    across = first_axis - (first_axis @ tangents[0]) * tangents[0]
    if not np.linalg.norm(across) > 1e-6 * np.linalg.norm(first_axis):
        raise MeshError(name, f"starts along its first_axis {first_axis.tolist()}; choose one across it")
    axes = np.empty((len(tangents), 3, 3))
    across = across / np.linalg.norm(across)
    axes[0] = np.column_stack([tangents[0], across, np.cross(tangents[0], across)])
    for k, (before, after) in enumerate(pairwise(tangents), start=1):
        axis, cosine = np.cross(before, after), float(before @ after)
        if cosine < -0.5:
            raise MeshError(name, f"turns back between its sections {k - 1} and {k}; take more elements")
        v = axes[k - 1][:, 1]
        turned = cosine * v + np.cross(axis, v) + axis * (axis @ v) / (1.0 + cosine)
        turned -= (turned @ after) * after
        turned /= np.linalg.norm(turned)
        axes[k] = np.column_stack([after, turned, np.cross(after, turned)])
    return axes


def rod_surface(mesh: RodMesh) -> tuple[SurfaceMesh, Embedding]:
    """Return the closed surface of a rod through its sections' outlines, and its embedding in the nodes."""
    sections, corners = mesh.outlines.shape[:2]
    local = np.concatenate([mesh.outlines, np.zeros((sections, 1, 2))], axis=1)
    rings = mesh.centres[:, None] + local @ np.swapaxes(mesh.axes[..., 1:], 1, 2)
    points = np.concatenate([rings[:, :corners].reshape(-1, 3), rings[[0, -1], corners]])
    weights = np.zeros((sections, corners + 1, 4))
    for k in range(sections):  # barycentric in the triangle of the nodes
        square = np.vstack([mesh.spread[k].T, np.ones(3)])
        weights[k, :, :3] = np.linalg.solve(square, np.vstack([local[k].T, np.ones(corners + 1)])).T
    nodes = (NODES * np.arange(sections))[:, None, None] + np.array([0, 1, 2, 0])
    weights, nodes = (
        np.concatenate([each[:, :corners].reshape(-1, 4), each[[0, -1], corners]])
        for each in (weights, np.broadcast_to(nodes, weights.shape))
    )
    ring, ahead = np.arange(corners), (np.arange(corners) + 1) % corners
    before = (corners * np.arange(sections - 1))[:, None]
    here, there = before + ring, before + ahead
    sides = [(here, there, there + corners), (here, there + corners, here + corners)]
    last, start, end = corners * (sections - 1), corners * sections, corners * sections + 1
    caps = [(np.full(corners, start), ahead, ring), (np.full(corners, end), last + ring, last + ahead)]
    triangles = [np.stack(each, axis=-1).reshape(-1, 3) for each in (*sides, *caps)]
    surface = SurfaceMesh(points, np.concatenate(triangles).astype(np.int64), mesh.name)
    cell = np.minimum(np.repeat(np.arange(sections), corners) // 2, len(mesh.cells) - 1)
    of_cells = np.concatenate([cell, [0, len(mesh.cells) - 1]])
    return surface, Embedding(of_cells.astype(np.int64), weights, nodes, np.zeros(len(points)))


def node_triangles(mesh: RodMesh) -> IndexArray:
    """Return the closed surface through the nodes themselves, shape (t, 3)."""
    surface, _ = rod_surface(replace(mesh, outlines=mesh.spread))
    last = NODES * (len(mesh.centres) - 1)  # its caps are fans about a centre, which is no node
    caps = np.array([[0, 2, 1], [last, last + 1, last + 2]])
    return np.concatenate([surface.triangles[: 2 * last], caps]).astype(np.int64)
