"""Surfaces that touch: what they are, which may meet, and which cannot be used."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from softsim_core.arrays import Array, BoolArray, IndexArray
from softsim_core.errors import SceneError
from softsim_core.mesh.surface import is_closed

_CHUNK = 256


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CollisionSurface:
    """A triangle surface, or a sphere, over a range of the global array of collision vertices.

    Attributes:
        name: Name, for messages.
        vertices: Range of its vertices in the global array; surfaces share no vertex. A sphere has one.
        triangles: Global vertex indices, outward by the right-hand rule, shape (k, 3); a sphere has none.
        groups: Names of the groups it belongs to.
        owner: Number of the body it belongs to.
        moving: Whether it can move; two surfaces that cannot never meet.
        radius: Radius in [m] of a sphere; 0 for triangles.
        closed: Whether the triangles enclose a volume; worked out.
    """

    name: str
    vertices: slice
    triangles: IndexArray = field(default_factory=lambda: np.empty((0, 3), dtype=np.int64))
    groups: frozenset[str] = frozenset()
    owner: int
    moving: bool = True
    radius: float = 0.0
    closed: bool = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "closed", self.radius > 0.0 or is_closed(self.triangles))


def may_meet(a: CollisionSurface, b: CollisionSurface) -> bool:
    """Whether two surfaces are checked against each other.

    A shared group: never. Of one body: only where each has groups. Both standing still: never.
    """
    if a is b or not (a.moving or b.moving) or a.groups & b.groups:
        return False
    return a.owner != b.owner or bool(a.groups and b.groups)


def check_surface(points: Array, triangles: IndexArray, name: str, *, closed: bool = False) -> None:
    """Refuse a surface that cannot be used for contact.

    Args:
        points: Vertex positions in [m], shape (n, 3).
        triangles: Vertex indices, shape (k, 3).
        name: What it is called in the message.
        closed: Whether it must enclose a volume (a body with mass).

    Raises:
        SceneError: it has a triangle without area, crosses itself, or is open where it must be closed.
    """
    corners = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1, initial=0.0)
    flat = np.flatnonzero(np.linalg.norm(normals, axis=1) <= 1e-12 * longest**2)
    if len(flat):
        raise SceneError(f"surface {name}: triangle {flat[0]} has no area; remove it or repair the mesh")
    if closed and not is_closed(triangles):
        raise SceneError(
            f"surface {name}: it is open or its triangles are turned unevenly; a body with mass needs a "
            "closed surface, so close its holes and turn all triangles outward"
        )
    crossing = _first_crossing(corners, triangles)
    if crossing is not None:
        where = ", ".join(f"{x:.4g}" for x in corners[crossing[0]].mean(axis=0))
        raise SceneError(
            f"surface {name}: triangles {crossing[0]} and {crossing[1]} cross each other near ({where}) m; "
            "repair the mesh so that the surface does not cross itself"
        )


def _first_crossing(corners: Array, triangles: IndexArray) -> tuple[int, int] | None:
    """Two triangles without a common vertex that cross, or None."""
    low, high = corners.min(axis=1), corners.max(axis=1)
    for start in range(0, len(triangles), _CHUNK):
        end = start + _CHUNK
        near = np.ones((len(low[start:end]), len(low)), dtype=bool)
        for axis in range(3):
            near &= low[start:end, axis, None] <= high[:, axis]
            near &= high[start:end, axis, None] >= low[:, axis]
        first, second = np.nonzero(near)
        first += start
        apart = (triangles[first][:, :, None] != triangles[second][:, None, :]).all(axis=(1, 2))
        first, second = first[apart], second[apart]
        hit = np.flatnonzero(_edges_cross(corners[first], corners[second]))
        if len(hit):
            return int(first[hit[0]]), int(second[hit[0]])
    return None


def _edges_cross(edges_of: Array, faces: Array) -> BoolArray:
    """Whether an edge of the first triangle passes through the second, shapes (p, 3, 3)."""
    a, b, c = faces[:, None, 0], faces[:, None, 1], faces[:, None, 2]
    start, end = edges_of, np.roll(edges_of, -1, axis=1)
    sides = _volume(a, b, c, start) * _volume(a, b, c, end)
    turns = np.stack(
        [_volume(start, end, a, b), _volume(start, end, b, c), _volume(start, end, c, a)], axis=-1
    )
    through = (turns > 0.0).all(axis=-1) | (turns < 0.0).all(axis=-1)
    return np.asarray(((sides < 0.0) & through).any(axis=1))


def _volume(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Six times the signed volume of tetrahedra (..., 3)."""
    return np.asarray(np.sum(np.cross(b - a, c - a) * (d - a), axis=-1))
