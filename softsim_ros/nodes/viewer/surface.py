"""Draw the visible surface of bodies, plain or coloured by stress, and wire frames."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from itertools import product
from typing import Any, Final

import numpy as np
from cmap import Colormap
from numpy.typing import NDArray

from softsim_core.base import Array, IndexArray
from softsim_core.physics.mechanics import rotation_euler
from softsim_core.scene import Section, StressMap, ViewSettings

CIRCLE_STEPS = 32


def box_lines(center: tuple[float, ...], size: tuple[float, ...], rotation_deg: tuple[float, ...]) -> Array:
    """Return the 12 edges of an oriented box, shape (12, 2, 3), in the unit of the arguments."""
    corners = np.array(list(product((-0.5, 0.5), repeat=3)))
    pairs = [(a, b) for a in range(8) for b in range(a + 1, 8) if (corners[a] != corners[b]).sum() == 1]
    placed = np.array(center) + (corners * np.array(size)) @ rotation_euler(np.radians(rotation_deg)).T
    return np.asarray(placed[np.array(pairs)])


def sphere_lines(center: tuple[float, ...], radius: float) -> Array:
    """Return three circles of a sphere as lines, shape (3 CIRCLE_STEPS, 2, 3)."""
    angle = np.linspace(0.0, 2.0 * np.pi, CIRCLE_STEPS + 1)
    lines = []
    for axis in range(3):
        circle = np.zeros((len(angle), 3))
        circle[:, (axis + 1) % 3], circle[:, (axis + 2) % 3] = np.cos(angle), np.sin(angle)
        lines.append(np.stack([circle[:-1], circle[1:]], axis=1))
    return np.asarray(np.array(center) + radius * np.concatenate(lines))


def shrunk_faces(points: Array, tetrahedra: IndexArray, share: float) -> tuple[Array, IndexArray]:
    """Return tetrahedra scaled by `share` about their centres: vertices (4 m, 3), faces (4 m, 3)."""
    corners = points[tetrahedra]
    centre = corners.mean(axis=1, keepdims=True)
    vertices = (centre + share * (corners - centre)).reshape(-1, 3)
    sides = np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])
    faces = (4 * np.arange(len(tetrahedra))[:, None, None] + sides).reshape(-1, 3)
    return vertices, faces


def normal_lines(points: NDArray[np.float32], triangles: IndexArray, length: float) -> NDArray[np.float32]:
    """Return lines from the centre of each triangle (k, 3) along its normal, shape (k, 2, 3).

    Degenerate triangles are skipped.
    """
    corners = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normals, axis=1)
    is_proper = size > 0.0
    start = corners[is_proper].mean(axis=1)
    end = start + length * normals[is_proper] / size[is_proper, None]
    return np.stack([start, end], axis=1).astype(np.float32)


MM: Final = 1000.0
"""Millimetres per metre; the page uses millimetres."""

BANDS: Final = 12
"""Number of colours of the stress scale; a viser mesh has one colour, so each band is its own mesh."""

REGROUP_PERIOD_S: Final = 0.2
"""Period in [s] at which triangles are sorted into bands; in between only vertices move."""

GHOST_COLOUR: Final = (134, 142, 150)
GHOST_OPACITY: Final = 0.18
NO_FACES: Final = np.zeros((1, 3), np.uint32)
"""Triangles of an invisible mesh."""

Points = NDArray[np.float32]


@dataclass(frozen=True)
class Part:
    """Part of the surface that belongs to one body.

    Attributes:
        name: Name of the body.
        points: First and end index of its vertices.
        triangles: Its triangles, with indices into all vertices, shape (k, 3).
        colour: Red, green, blue, alpha in 0..1.
    """

    name: str
    points: tuple[int, int]
    triangles: IndexArray
    colour: tuple[float, float, float, float]

    @property
    def rgb(self) -> tuple[int, ...]:
        """Red, green, blue in 0..255."""
        return tuple(round(255 * channel) for channel in self.colour[:3])


class Lines:
    """Line segments in the picture that move, appear and disappear; sizes in [mm]."""

    def __init__(self, scene: Any, name: str, colour: tuple[int, int, int], thickness: float) -> None:
        self._scene, self._name, self._colour, self._thickness = scene, name, colour, thickness
        self._drawn: Any = None

    def show(self, lines: Points | None) -> None:
        """Draw lines, shape (k, 2, 3), instead of the previous ones; None or an empty array removes them."""
        count = 0 if lines is None else len(lines)
        if self._drawn is not None and len(self._drawn.points) == count:
            self._drawn.points = lines
            return
        if self._drawn is not None:
            self._drawn.remove()
            self._drawn = None
        if count:
            self._drawn = self._scene.add_line_segments(
                self._name, lines, self._colour, thickness=self._thickness
            )


@cache
def band_colours(stress_map: StressMap) -> tuple[tuple[int, int, int], ...]:
    """Return red, green, blue in 0..255 of each band, taken from the centre of its part of the scale."""
    table = Colormap(f"matplotlib:{stress_map}").lut(BANDS)[:, :3]
    return tuple((int(r), int(g), int(b)) for r, g, b in np.rint(255.0 * table))


def bands_of(stress: NDArray[Any], triangles: IndexArray, highest: float) -> NDArray[np.int64]:
    """Return the band of each triangle by the mean stress of its corners, shape (k,)."""
    if not highest > 0.0:
        return np.zeros(len(triangles), dtype=np.int64)
    mean = stress[triangles].mean(axis=1)
    return np.clip((mean * (BANDS / highest)).astype(np.int64), 0, BANDS - 1)


def compact(triangles: IndexArray, count: int) -> tuple[IndexArray, NDArray[np.uint32]]:
    """Return the used vertices in ascending order, and the triangles with indices into them.

    Args:
        triangles: Indices into `count` vertices, shape (k, 3).
        count: Number of all vertices.
    """
    used = np.zeros(count, dtype=bool)
    used[triangles] = True
    number = np.cumsum(used) - 1
    return np.flatnonzero(used), number[triangles].astype(np.uint32)


def round_up(value: float) -> float:
    """Return the smallest of 1, 2, 5, 10, ... (times powers of ten) that is not below `value`.

    Return 1 for a value that is not positive.
    """
    if not value > 0.0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    return next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= value * (1.0 - 1e-9))


def next_top(shown: float, highest: float) -> float:
    """Return the top of a scale for a `highest` value; hysteresis avoids flicker between two scales."""
    top = round_up(highest)
    return top if highest > shown or top < 0.45 * shown else shown


def select_visible(points: Points, triangles: IndexArray, section: Section | None) -> IndexArray:
    """Return the triangles (k, 3) on the visible side of a section, by their centres; `points` in [mm]."""
    if section is None:
        return triangles
    axis = "xyz".index(section.axis)
    return triangles[points[:, axis][triangles].mean(axis=1) <= MM * section.at]


@dataclass
class _Band:
    mesh: Any
    vertices: IndexArray = field(default_factory=lambda: np.zeros(0, np.int64))


class SurfaceView:
    """The surface in the page.

    `on_mesh` is called with every new mesh, to attach mouse events.

    Attributes:
        points: Vertices of all bodies in [mm], shape (p, 3).
        triangles: Triangles that are neither hidden nor cut away, shape (k, 3).
    """

    def __init__(self, scene: Any, on_mesh: Callable[[Any], None]) -> None:
        self._scene, self._on_mesh = scene, on_mesh
        self._parts: list[Part] = []
        self._whole: IndexArray = np.zeros((0, 3), np.int64)
        self._rest: Points = np.zeros((0, 3), np.float32)
        self._plain: list[tuple[Part, Any]] = []
        self._bands: list[_Band] = []
        self._ghosts: list[Any] = []
        self._regrouped_at = -math.inf
        self._view = ViewSettings()
        self.triangles: IndexArray = self._whole
        self.points: Points = np.zeros((0, 3), np.float32)
        self.stress: Points = np.zeros(0, np.float32)
        self.shown_top = 1.0

    def show(self, parts: list[Part], points: Points) -> None:
        """Show another surface at rest; `points` in [mm], shape (p, 3)."""
        self._parts, self.points, self._rest = parts, np.array(points), np.array(points)
        self.stress = np.zeros(len(points), np.float32)
        self.rebuild()

    def apply_view(self, view: ViewSettings) -> None:
        """Apply view settings; meshes are rebuilt only if they depend on a change."""
        before, self._view = self._view, view
        if _looks(before) != _looks(view):
            self.rebuild()

    def rebuild(self) -> None:
        """Rebuild all meshes."""
        for mesh in (*(mesh for _, mesh in self._plain), *(band.mesh for band in self._bands), *self._ghosts):
            mesh.remove()
        self._plain, self._bands, self._ghosts = [], [], []
        view = self._view
        shown = [part for part in self._parts if f"bodies/{part.name}" not in view.hidden]
        self._whole = np.concatenate([np.zeros((0, 3), np.int64), *(part.triangles for part in shown)])
        self.triangles = select_visible(self.points, self._whole, view.section)
        if view.ghost:
            self._ghosts = [self._ghost_of(part) for part in shown]
        if not view.bodies or not len(self._whole):
            return
        if view.stress:
            self._bands = [
                _Band(
                    self._make_mesh(
                        f"/stress/{index:02d}", self.points[:3], NO_FACES, color=colour, flat_shading=True
                    )
                )
                for index, colour in enumerate(band_colours(view.stress_map))
            ]
            self._regroup()
            return
        for part in shown:
            own, alpha = self.points[slice(*part.points)], part.colour[3]
            faces, opacity = self._faces_of(part), None if alpha >= 1.0 else alpha
            mesh = self._make_mesh(f"/bodies/{part.name}", own, faces, color=part.rgb, opacity=opacity)
            self._plain.append((part, mesh))

    def _make_mesh(self, name: str, points: Points, faces: NDArray[np.uint32], **looks: Any) -> Any:
        mesh = self._scene.add_mesh_simple(
            name, points, faces, wireframe=self._view.wireframe, side="double", **looks
        )
        self._on_mesh(mesh)
        return mesh

    def update(self, points: Points, stress: Points, now: float) -> None:
        """Move the vertices and recolour them.

        Args:
            points: Positions in [mm], shape (p, 3).
            stress: Stress in [Pa], shape (p,).
            now: Steady clock in [s].
        """
        if points.shape != self.points.shape:
            return  # of another scene, without its triangles yet
        self.points, self.stress = points, stress
        for part, mesh in self._plain:
            mesh.vertices = points[slice(*part.points)]
        sorts = self._bands or self._view.section is not None
        if sorts and now - self._regrouped_at >= REGROUP_PERIOD_S:
            self._regrouped_at = now
            self.triangles = select_visible(points, self._whole, self._view.section)
            for part, mesh in self._plain:
                mesh.faces = self._faces_of(part)
            self._regroup()
        else:
            for band in self._bands:
                band.mesh.vertices = points[band.vertices]

    def nearest(self, position: Points) -> int:
        """Return the index of the vertex nearest to a position in [mm]."""
        return int(np.argmin(((self.points - position) ** 2).sum(axis=1)))

    def _faces_of(self, part: Part) -> NDArray[np.uint32]:
        """Return the visible triangles of a part, with its own vertex indices; NO_FACES if there are none."""
        left = select_visible(self.points, part.triangles, self._view.section)
        return (left - part.points[0]).astype(np.uint32) if len(left) else NO_FACES

    def _ghost_of(self, part: Part) -> Any:
        """Draw a body at rest; return its handle."""
        return self._scene.add_mesh_simple(
            f"/ghost/{part.name}",
            self._rest[slice(*part.points)],
            (part.triangles - part.points[0]).astype(np.uint32),
            color=GHOST_COLOUR,
            opacity=GHOST_OPACITY,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )

    def _regroup(self) -> None:
        highest = float(np.max(self.stress, initial=0.0))
        if self._view.stress_top is not None:
            self.shown_top = self._view.stress_top
        else:
            self.shown_top = next_top(self.shown_top, highest)
        band_of = bands_of(self.stress, self.triangles, self.shown_top)
        for index, band in enumerate(self._bands):
            own = self.triangles[band_of == index]
            if len(own):
                band.vertices, faces = compact(own, len(self.points))
            else:  # hiding the mesh would leave holes for a frame, so it shrinks to a point
                band.vertices, faces = np.arange(3), NO_FACES
            band.mesh.vertices = self.points[band.vertices]
            band.mesh.faces = faces


def _looks(view: ViewSettings) -> tuple[object, ...]:
    """Return the view settings on which the meshes depend."""
    how = (view.bodies, view.stress, view.stress_map, view.wireframe, view.ghost, view.section)
    return (*how, frozenset(view.hidden))
