"""Reading of a part: its surface in metres, its shells, and its own axes."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from itertools import permutations
from os import PathLike
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from softsim_core.base import (
    MILLIMETRE,
    Array,
    BoolArray,
    FormerAttribute,
    IndexArray,
    MeshError,
    Placement,
    known_names,
)
from softsim_core.lab.meshing.topology import connected, shells
from softsim_core.physics.contact import crossings
from softsim_core.physics.mesh import SurfaceMesh, enclosed_volume, encloses, read_surface, triangle_normals

_SMALLER = 0.9  # a box along other axes must be smaller by this factor, else the file's axes are used
_ALONG = 0.999  # cosine of the largest angle between a face and the axis to which it belongs
_NORMALS = 30


def own_axes(surface: SurfaceMesh) -> Array:
    """Return the axes of a part's main faces as columns, shape (3, 3): proper, ordered by x, y and z.

    They are the axes of the file, unless a box along others is clearly smaller and more of the part's faces
    are perpendicular to these. Candidates are the largest faces of the convex hull and the principal axes of
    its corners, each with the best rotation around it. The surface must be closed.
    """
    points = surface.points[np.unique(surface.triangles)]
    try:
        hull = ConvexHull(points)
    except QhullError:  # flat
        return np.eye(3)
    corners = points[hull.vertices]
    best, found = _SMALLER * float(np.prod(np.ptp(corners, axis=0))), np.eye(3)
    for direction in _directions(corners, points[hull.simplices]):
        axes = _turned_about(direction, corners)
        volume = float(np.prod(np.ptp(corners @ axes, axis=0)))
        if volume < best * (1.0 - 1e-6):
            best, found = volume, axes
    return _next_to_file(found) if _along(surface, found) > _along(surface, np.eye(3)) else np.eye(3)


def _along(surface: SurfaceMesh, axes: Array) -> float:
    """Return the area in [m^2] of the faces that are perpendicular to the axes."""
    normals = triangle_normals(surface.points, surface.triangles)
    sizes = np.linalg.norm(normals, axis=1)
    return float(sizes[np.abs(normals @ axes).max(axis=1) > _ALONG * sizes].sum())


def _directions(corners: Array, faces: Array) -> Array:
    """Return unit candidate directions of the box, shape (k, 3)."""
    areas = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    sizes = np.linalg.norm(areas, axis=1)
    normals = areas[sizes > 0.0] / sizes[sizes > 0.0, None]
    normals[normals[:, 2] < 0.0] *= -1.0
    _, group = np.unique(np.round(normals, 3), axis=0, return_inverse=True)
    weights = np.bincount(group.reshape(-1), sizes[sizes > 0.0])
    largest = np.argsort(-weights, kind="stable")[:_NORMALS]
    sums = [normals[group.reshape(-1) == each].sum(axis=0) for each in largest]
    principal = np.linalg.svd(corners - corners.mean(axis=0), full_matrices=False)[2]
    chosen = np.concatenate([np.array(sums).reshape(-1, 3), principal])
    return np.asarray(chosen / np.linalg.norm(chosen, axis=1, keepdims=True))


def _turned_about(direction: Array, corners: Array) -> Array:
    """Return a direction and the two across it with the smallest rectangle around the corners, (3, 3)."""
    first = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    first /= np.linalg.norm(first)
    second = np.cross(direction, first)
    projected = corners @ np.stack([first, second], axis=1)
    flat = projected[ConvexHull(projected).vertices]
    sides = np.roll(flat, -1, axis=0) - flat
    angles = np.arctan2(sides[:, 1], sides[:, 0])
    along, across = (np.stack([np.cos(a), np.sin(a)]) for a in (angles, angles + 0.5 * np.pi))
    areas = np.ptp(flat @ along, axis=0) * np.ptp(flat @ across, axis=0)
    k = int(areas.argmin())
    turned = np.stack([first, second], axis=1) @ np.stack([along[:, k], across[:, k]], axis=1)
    return np.column_stack([turned, direction])


def _next_to_file(axes: Array) -> Array:
    """Return the same three axes in the order and with the signs nearest to x, y and z."""
    order = list(max(permutations(range(3)), key=lambda each: float(np.abs(axes[:, list(each)]).trace())))
    result = axes[:, order] * np.sign(np.diag(axes[:, order]) + 1e-300)
    if np.linalg.det(result) < 0.0:
        weakest = int(np.abs(np.diag(result)).argmin())
        result[:, weakest] *= -1.0
    return np.asarray(result)


SPECK = 0.005
"""A shell with a smaller part of the largest one's diagonal is dropped."""


@dataclass(frozen=True, slots=True, eq=False)
class Nesting:
    """Closed shells and their nesting.

    Attributes:
        triangles: Triangles by shell, solids outward, cavities into the cavity, shape (k, 3).
        label: Shell of each triangle, shape (k,).
        volumes: Volume of each shell, > 0, in the unit of the points cubed, shape (s,).
        diagonals: Diagonal of the box around each shell, in the unit of the points, shape (s,).
        depth: Number of shells around each shell; odd ones are cavities, shape (s,).
        body: Body of each shell: intersecting solids are one, a cavity belongs to the solid around it, (s,).
        crossing: Pairs of intersecting triangles, shape (c, 2).
        turned: Number of shells that were turned inside out.
    """

    triangles: IndexArray
    label: IndexArray
    volumes: Array
    diagonals: Array
    depth: IndexArray
    body: IndexArray
    crossing: IndexArray
    turned: int

    @property
    def cavities(self) -> BoolArray:
        """Which shells are cavities."""
        return np.asarray(self.depth % 2 == 1)


def determine_nesting(points: Array, triangles: IndexArray) -> Nesting:
    """Determine the nesting of closed shells of triangles (k, 3), each consistently oriented."""
    count, label = shells(triangles)
    triangles = triangles.copy()
    order = np.argsort(label, kind="stable")
    parts = np.split(order, np.cumsum(np.bincount(label, minlength=count))[:-1])
    volumes = np.array([enclosed_volume(points, triangles[part]) for part in parts])
    crossing = crossings(points[triangles], triangles)
    cross = np.zeros((count, count), dtype=bool)
    cross[label[crossing[:, 0]], label[crossing[:, 1]]] = True
    cross |= cross.T
    low = np.array([points[triangles[part]].min(axis=(0, 1)) for part in parts])
    high = np.array([points[triangles[part]].max(axis=(0, 1)) for part in parts])
    inside = np.zeros((count, count), dtype=bool)
    for k, part in enumerate(parts):
        boxed = (low <= low[k]).all(axis=1) & (high >= high[k]).all(axis=1) & ~cross[k]
        boxed[k] = False
        place = points[triangles[part[0]]].mean(axis=0)
        for other in np.flatnonzero(boxed).tolist():
            inside[k, other] = encloses(points, triangles[parts[other]], place)
    depth = inside.sum(axis=1)
    cavity = depth % 2 == 1
    turned = (volumes < 0.0) != cavity
    for k in np.flatnonzero(turned).tolist():
        triangles[parts[k]] = triangles[parts[k]][:, ::-1]
    for k in np.flatnonzero(cavity).tolist():  # it belongs to the body around it
        around = np.flatnonzero(inside[k])
        cross[k, around[depth[around].argmax()]] = True
    _, body = connected(count, *cross.nonzero())
    diagonals = np.linalg.norm(high - low, axis=1)
    return Nesting(triangles, label, np.abs(volumes), diagonals, depth, body, crossing, int(turned.sum()))


UNITS = {"um": 1.0e-6, "mm": MILLIMETRE, "cm": 1.0e-2, "m": 1.0, "in": 2.54e-2}
"""Units of length of files, in [m]."""
_SMALL, _LARGE = 1.0e-2, 3.0
"""Longest sides in [m] outside of which the unit is questioned."""
_SMALLEST, _LARGEST = 1.0e-7, 1.0e4
"""Longest sides in [m] outside of which a part is rejected."""


@dataclass(frozen=True, slots=True)
class Unit:
    """The unit of a part's file, for messages about places in it.

    Attributes:
        name: One of UNITS.
        metres: Its length in [m].
    """

    name: str
    metres: float

    def length(self, metres: float) -> str:
        """Format a length in the file's unit: "12.3 mm"."""
        return f"{metres / self.metres:.4g} {self.name}"

    def size(self, metres: Array) -> str:
        """Format lengths along the axes: "10 x 20 x 5 mm"."""
        return " x ".join(f"{each / self.metres:.4g}" for each in metres) + f" {self.name}"

    def place(self, metres: Array) -> str:
        """Format a place: "(1, 2, 3) mm"."""
        rounded = np.round(metres / self.metres, 4) + 0.0  # no -0
        return "(" + ", ".join(f"{each:.5g}" for each in rounded) + f") {self.name}"


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A part as read from its file.

    Attributes:
        surface: Triangles in [m] without changes, named after the file.
        unit: The file's unit.
        remarks: Messages about unusual properties.
    """

    surface: SurfaceMesh
    unit: Unit
    remarks: tuple[str, ...] = ()
    told = FormerAttribute("remarks")


def unit(name: str) -> Unit:
    """Return a unit by its name, or raise MeshError if it is not known."""
    if name not in UNITS:
        raise MeshError(name, f"is no unit of length that is known; {known_names(name, UNITS, 'known are')}")
    return Unit(name, UNITS[name])


_CURVED = frozenset((".step", ".stp", ".iges", ".igs", ".brep", ".x_t", ".sldprt", ".ipt", ".f3d", ".fcstd"))
"""File types of CAD programs; the available readers of their curved faces are under the LGPL."""


def read_part(path: str | PathLike[str], unit_name: str = "mm") -> Part:
    """Read the surface of a part.

    Args:
        path: A file that `mesh.read_surface` reads: STL, OBJ, PLY, OFF and others.
        unit_name: Unit of its lengths, one of UNITS; CAD programs export STL in mm.

    Raises:
        MeshError: the file cannot be read, has no extent, or cannot be in that unit.
    """
    file, in_unit = Path(path), unit(unit_name)
    if file.suffix.lower() in _CURVED:
        raise MeshError(
            file, "is a CAD model of curved faces, which is not read; export it as STL, OBJ, PLY or OFF"
        )
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        surface = read_surface(file, Placement(scale=in_unit.metres))
    remarks = [str(each.message).removeprefix(f"mesh {file}: ") for each in caught]
    size = np.ptp(surface.points, axis=0)
    longest = float(size.max())
    if not _SMALLEST <= longest <= _LARGEST:
        raise MeshError(
            file, f"is {longest:.3g} m long, if its unit is {unit_name}; say the unit it is in with --unit"
        )
    if not _SMALL <= longest <= _LARGE:
        remarks.append(f"it is {longest:.3g} m long, if its unit is {unit_name}: is that so? else say --unit")
    return Part(surface, in_unit, tuple(remarks))
