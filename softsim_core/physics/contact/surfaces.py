"""Collision surfaces: their definition, which pairs may meet, and which cross or overlap at the start."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Container, Iterator
from dataclasses import dataclass, field

import numpy as np

from softsim_core.base import Array, BoolArray, IndexArray, SceneError
from softsim_core.physics.mesh import closest_point, is_closed, triangle_normals, winding_numbers

_CHUNK = 256
_PAIRS = 1 << 20
"""Number of box pairs that are tested together."""
_ROUNDING = 16.0 * float(np.finfo(float).eps)
"""Relative rounding error of a coordinate, with a margin; volumes below what it can produce count as zero."""
_SHIFTS = 3.0e-5 * np.array(list(itertools.product((1.0, -1.0), repeat=3))) * (1.0, 0.83, 0.71)
"""Small shifts, as shares of the smaller surface's size. At least one of them separates surfaces that only
touch; they are oblique, so that none moves an edge exactly through another one.
"""

_TOUCH = 1.0e-7
"""Share of the smaller surface's size up to which an overlap counts as touching."""
_WINDING_CHUNK = 1 << 18
_WITHIN = 1.0e-5
"""Depth of the probes behind a surface's triangles, as a share of their size."""


def surfaces_cross(first: Array, second: Array) -> bool:
    """Return whether two surfaces cross, and still cross after a small shift in any direction.

    Args:
        first: Corners of the triangles in [m], shape (k, 3, 3).
        second: Corners of the triangles in [m], shape (m, 3, 3).
    """
    size = min(float(np.linalg.norm(np.ptp(each, axis=(0, 1)))) for each in (first, second))
    return all(_any_crosses(first, second + size * shift) for shift in _SHIFTS)


def self_crossing(corners: Array, triangles: IndexArray) -> tuple[int, int] | None:
    """Return the first two triangles found that share no vertex and cross, or None.

    Args:
        corners: Corners in [m], shape (k, 3, 3).
        triangles: Vertices of the triangles, shape (k, 3).
    """
    return next(((int(each[0, 0]), int(each[0, 1])) for each in _hits(corners, triangles) if len(each)), None)


def crossings(corners: Array, triangles: IndexArray) -> IndexArray:
    """Return all pairs of triangles of a surface that share no vertex and cross, shape (c, 2), ascending.

    Args:
        corners: Corners in one unit, shape (k, 3, 3).
        triangles: Vertices of the triangles, shape (k, 3).
    """
    pairs = np.concatenate([np.empty((0, 2), dtype=np.int64), *_hits(corners, triangles)])
    return pairs[np.lexsort(pairs.T[::-1])]


def _hits(corners: Array, triangles: IndexArray) -> Iterator[IndexArray]:
    """Yield pairs of triangles that cross, in batches, shape (c, 2)."""
    for i, j in _near_pairs(corners):
        strangers = (triangles[i][:, :, None] != triangles[j][:, None, :]).all(axis=(1, 2))
        i, j = i[strangers], j[strangers]
        hit = _pierce(corners[i], corners[j]) | _pierce(corners[j], corners[i])
        yield np.sort(np.column_stack([i, j])[hit], axis=1)


def _near_pairs(corners: Array) -> Iterator[tuple[IndexArray, IndexArray]]:
    """Yield pairs of triangles whose boxes intersect, each once, by a sweep along the longest axis."""
    if not len(corners):
        return
    low, high = corners.min(axis=1), corners.max(axis=1)
    axis = int(np.ptp(corners, axis=(0, 1)).argmax())
    order = np.argsort(low[:, axis], kind="stable")
    low, high = low[order], high[order]
    ahead = np.searchsorted(low[:, axis], high[:, axis], side="right") - np.arange(1, len(order) + 1)
    ends = np.cumsum(ahead)
    start = 0
    while start < len(order):
        stop = max(start + 1, int(np.searchsorted(ends, ends[start] - ahead[start] + _PAIRS, side="right")))
        count = ahead[start:stop]
        i = np.repeat(np.arange(start, stop), count)
        j = i + 1 + np.arange(len(i)) - np.repeat(np.cumsum(count) - count, count)
        meet = ((low[i] <= high[j]) & (high[i] >= low[j])).all(axis=1)
        yield order[i[meet]], order[j[meet]]
        start = stop


def _any_crosses(first: Array, second: Array) -> bool:
    """Return whether a triangle of the first surface crosses one of the second."""
    low, high = second.min(axis=(0, 1)), second.max(axis=(0, 1))
    some = first[((first.min(axis=1) <= high) & (first.max(axis=1) >= low)).all(axis=1)]
    for start in range(0, len(some), _CHUNK):
        part = some[start : start + _CHUNK]
        i, j = _boxes_meet(part, second)
        if (_pierce(part[i], second[j]) | _pierce(second[j], part[i])).any():
            return True
    return False


def _boxes_meet(first: Array, second: Array) -> tuple[IndexArray, IndexArray]:
    """Return the pairs of triangles whose boxes intersect."""
    near = np.ones((len(first), len(second)), dtype=bool)
    for axis in range(3):
        a, b = first[:, None, :, axis], second[:, :, axis]
        near &= (a.min(axis=2) <= b.max(axis=1)) & (a.max(axis=2) >= b.min(axis=1))
    i, j = np.nonzero(near)
    return i, j


def _pierce(edges_of: Array, faces: Array) -> BoolArray:
    """Return whether an edge of the first triangle passes through the second, shapes (p, 3, 3).

    Triangles that are coplanar up to rounding do not pierce each other.
    """
    a, b, c = faces[:, None, 0], faces[:, None, 1], faces[:, None, 2]
    start, end = edges_of, np.roll(edges_of, -1, axis=1)
    both = np.concatenate([edges_of, faces], axis=1)
    sizes = np.ptp(both, axis=1).max(axis=1, initial=0.0)
    noise = (_ROUNDING * np.abs(both).max(axis=(1, 2), initial=0.0) * sizes**2)[:, None]
    one, other = _volume(a, b, c, start), _volume(a, b, c, end)
    apart = (np.minimum(one, other) < -noise) & (np.maximum(one, other) > noise)
    turns = np.stack(
        [_volume(start, end, a, b), _volume(start, end, b, c), _volume(start, end, c, a)], axis=-1
    )
    through = (turns > noise[..., None]).all(axis=-1) | (turns < -noise[..., None]).all(axis=-1)
    return np.asarray((apart & through).any(axis=1))


def _volume(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Return six times the signed volume of tetrahedra (..., 3)."""
    return np.asarray(np.sum(np.cross(b - a, c - a) * (d - a), axis=-1))


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
        soft: Whether it deforms, so that a sphere may press a dent into it.
        radius: Radius in [m] of a sphere; 0 for triangles.
        closed: Whether the triangles enclose a volume; computed.
    """

    name: str
    vertices: slice
    triangles: IndexArray = field(default_factory=lambda: np.empty((0, 3), dtype=np.int64))
    groups: frozenset[str] = frozenset()
    owner: int
    moving: bool = True
    soft: bool = False
    radius: float = 0.0
    closed: bool = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "closed", self.radius > 0.0 or is_closed(self.triangles))


def may_meet(a: CollisionSurface, b: CollisionSurface) -> bool:
    """Return whether two surfaces are checked against each other.

    Surfaces that share a group, and surfaces that cannot move, never meet. Surfaces of one body meet only if
    both have groups.
    """
    if a is b or not (a.moving or b.moving) or a.groups & b.groups:
        return False
    return a.owner != b.owner or bool(a.groups and b.groups)


def check_surface(
    points: Array, triangles: IndexArray, name: str, *, closed: bool = False, carried: bool = False
) -> None:
    """Refuse a surface that cannot be used for contact.

    Args:
        points: Vertex positions in [m], shape (n, 3).
        triangles: Vertex indices, shape (k, 3).
        name: Name in the message.
        closed: Whether it must enclose a volume (a body with mass).
        carried: Whether it belongs to a rigid body that something carries, such as a link of an arm. Such a
            surface may cross itself and then gives a warning.

    Raises:
        SceneError: it has a triangle without area, crosses itself, or is open where it must be closed.
    """
    corners = points[triangles]
    areas = np.linalg.norm(triangle_normals(points, triangles), axis=1)
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1, initial=0.0)
    flat = np.flatnonzero(2.0 * areas <= 1e-12 * longest**2)
    if len(flat):
        raise SceneError(f"surface {name}: triangle {flat[0]} has no area; remove it or repair the mesh")
    if closed and not is_closed(triangles):
        raise SceneError(
            f"surface {name}: it is open or its triangles are turned unevenly; a body with mass needs a "
            "closed surface, so close its holes and turn all triangles outward"
        )
    crossing = self_crossing(corners, triangles)
    if crossing is not None:
        where = ", ".join(f"{x:.4g}" for x in corners[crossing[0]].mean(axis=0))
        one, other = crossing
        problem = f"surface {name}: triangles {one} and {other} cross each other near ({where}) m"
        if not carried:
            raise SceneError(f"{problem}; repair the mesh so that the surface does not cross itself")
        warnings.warn(
            f"{problem}; what gets between its parts may be pushed the wrong way: repair the mesh, take its "
            "convex hull, or leave the body out of `collisions` (an arm: `touch: false`)",
            stacklevel=3,
        )


def first_overlap(
    surfaces: tuple[CollisionSurface, ...], points: Array, owners: Container[int] | None = None
) -> tuple[int, int] | None:
    """Return two surfaces of different bodies that cross, or the first inside the second; None: no such pair.

    Surfaces that only touch do not overlap. A point is inside where all surfaces of a body together enclose
    it; an open surface has no inside.

    Args:
        surfaces: Surfaces over the vertices.
        points: Vertex positions in [m], shape (v, 3).
        owners: Bodies, one of which must be in the pair; None: any.
    """

    def is_candidate_pair(a: CollisionSurface, b: CollisionSurface) -> bool:
        chosen = owners is None or a.owner in owners or b.owner in owners
        return chosen and a.owner != b.owner and may_meet(a, b)

    for i, a in enumerate(surfaces):
        for j, b in enumerate(surfaces[:i]):
            if is_candidate_pair(a, b) and _cross(a, b, points):
                return j, i
    for i, a in enumerate(surfaces):
        probes = _probes(a, points)
        for j, b in enumerate(surfaces):
            if b.radius > 0.0 or not is_candidate_pair(a, b):
                continue
            shell = np.concatenate([each.triangles for each in surfaces if each.owner == b.owner])
            if _find_enclosed(probes, points[shell]).any():
                return i, j
    return None


def touching(a: CollisionSurface, b: CollisionSurface, points: Array) -> float:
    """Return the overlap in [m] up to which two surfaces over vertices (v, 3) only touch."""
    sizes = (2.0 * s.radius or float(np.linalg.norm(np.ptp(points[s.vertices], axis=0))) for s in (a, b))
    return _TOUCH * min(sizes)


def _cross(a: CollisionSurface, b: CollisionSurface, points: Array) -> bool:
    """Return whether two surfaces cross; a sphere counts as solid."""
    if a.radius > 0.0 and b.radius > 0.0:
        apart = float(np.linalg.norm(points[a.vertices] - points[b.vertices]))
        return apart < a.radius + b.radius - touching(a, b, points)
    if a.radius > 0.0 or b.radius > 0.0:
        ball, other = (a, b) if a.radius > 0.0 else (b, a)
        centre = points[ball.vertices][0]
        distance = float(np.linalg.norm(centre - closest_point(centre, points[other.triangles])))
        return distance - ball.radius < -touching(a, b, points)
    return surfaces_cross(points[a.triangles], points[b.triangles])


def _probes(surface: CollisionSurface, points: Array) -> Array:
    """Return a point close behind each triangle, or the centre of a sphere, shape (p, 3)."""
    if surface.radius > 0.0:
        return np.asarray(points[surface.vertices])
    corners = points[surface.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.sqrt(np.linalg.norm(normals, axis=1, keepdims=True))  # about the edges' length
    return np.asarray(corners.mean(axis=1) - _WITHIN * normals)


def _find_enclosed(points: Array, corners: Array) -> BoolArray:
    """Return which points (p, 3) are inside closed triangles (k, 3, 3)."""
    result = np.zeros(len(points), dtype=bool)
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    near = np.flatnonzero(((points > low) & (points < high)).all(axis=1))
    step = max(1, _WINDING_CHUNK // len(corners))
    for some in np.split(near, range(step, len(near), step)):
        around = np.abs(winding_numbers(points[some], corners))
        result[some] = around > 0.999  # smaller where the surface has holes
    return result
