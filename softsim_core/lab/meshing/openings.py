"""Cavities with a narrow opening, and plugs that close it.

The part is sampled on a grid. If growing it by a clearance r separates a wide cavity from the outside, the
channel between them is at most 2 r wide: its narrowest place is the opening.

A piece of the channel's wall is removed, which leaves two flat open loops. Once they are closed, the part has
a lid on both sides of the plug, and its cavity can contain air.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from scipy import ndimage

from softsim_core.base import Array, BoolArray, IndexArray, MeshError
from softsim_core.lab.meshing.topology import connected, edges_of
from softsim_core.physics.mesh import SurfaceMesh

CELLS: Final = 72
"""Cells of the grid along the longest side."""
_NARROW: Final = 0.6  # largest width of an opening, as a part of the width of the cavity behind it
_LARGE: Final = 0.02  # least volume of a cavity, as a part of the volume of the part's box
_NEIGHBOURS: Final = np.concatenate([np.eye(3, dtype=int), -np.eye(3, dtype=int)])
_MOST: Final = 3  # more cavities than this belong to a lattice and are no air chambers


class OpenHollow(NamedTuple):
    """A cavity with an opening.

    Attributes:
        place: Narrowest place of its opening in [m], shape (3,).
        width: Width of the opening there in [m], accurate to about a cell of the grid.
        volume: Approximate volume of the cavity in [m^3].
    """

    place: Array
    width: float
    volume: float


def open_hollows(surface: SurfaceMesh) -> tuple[OpenHollow, ...]:
    """Find the cavities of a closed surface that narrow openings connect with the outside, the largest first.

    An opening narrower than two cells of the grid may be missed.
    """
    low, size = surface.points.min(axis=0), np.ptp(surface.points, axis=0)
    cell = float(size.max()) / CELLS
    margin = 2
    origin = low - (margin - 0.5) * cell
    shape = np.ceil(size / cell).astype(int) + 2 * margin
    free = ~_inside((surface.points - origin) / cell, surface.triangles, tuple(shape.tolist()))
    clearance = ndimage.distance_transform_edt(free)
    clearance[_border(free.shape)] = np.inf  # the outside is open all around
    found: list[OpenHollow] = []
    found_before = np.zeros_like(free)
    joined = free & _parts_with_border(free)
    widest = float(clearance[np.isfinite(clearance)].max())
    for radius in np.arange(1.5, widest, 0.5).tolist():
        apart = clearance > radius
        outside = _parts_with_border(apart)
        labels, count = ndimage.label(apart & ~outside & joined & ~found_before)
        for number in range(1, count + 1):
            core = labels == number
            wide = float(clearance[core].max())
            hollow = joined & (ndimage.distance_transform_edt(~core) <= radius)
            if radius > _NARROW * wide or hollow.sum() < _LARGE * np.prod(size / cell):
                continue
            neck = _neck(clearance, core, outside, radius)
            found_before |= hollow
            place = origin + cell * neck
            found.append(OpenHollow(place, 2.0 * cell * radius, float(hollow.sum()) * cell**3))
    return tuple(sorted(found, key=lambda each: -each.volume)) if len(found) <= _MOST else ()


def _inside(points: Array, triangles: IndexArray, shape: tuple[int, int, int]) -> BoolArray:
    """Return whether the centre of each cell (unit cubes at whole numbers) lies inside a closed surface."""
    corners = points[triangles] + [1.3e-5, 2.7e-5, 0.0]  # so that no edge passes through a centre
    low = np.ceil(corners[..., :2].min(axis=1)).astype(np.int64)
    high = np.floor(corners[..., :2].max(axis=1)).astype(np.int64)
    counts = np.maximum(high - low + 1, 0)
    each = counts.prod(axis=1)
    owner = np.repeat(np.arange(len(triangles)), each)
    number = np.arange(each.sum()) - np.repeat(np.cumsum(each) - each, each)
    columns = low[owner] + np.column_stack(np.divmod(number, np.maximum(counts[owner, 1], 1)))
    a, b, c = (corners[owner, k] for k in range(3))

    def side(p: Array, q: Array) -> Array:
        along, there = q[:, :2] - p[:, :2], columns - p[:, :2]
        return np.asarray(along[:, 0] * there[:, 1] - along[:, 1] * there[:, 0])

    shares = np.column_stack([side(b, c), side(c, a), side(a, b)])
    hit = (shares > 0.0).all(axis=1) | (shares < 0.0).all(axis=1)
    shares, columns = shares[hit], columns[hit]
    area = shares.sum(axis=1)
    heights = (shares * corners[owner[hit], :, 2]).sum(axis=1) / area
    crossing = np.zeros((*shape[:2], shape[2] + 1), dtype=np.int64)
    below = np.clip(np.ceil(heights).astype(np.int64), 0, shape[2])
    np.add.at(crossing, (columns[:, 0], columns[:, 1], below), -np.sign(area).astype(np.int64))
    return np.asarray(np.cumsum(crossing, axis=2)[..., :-1] > 0)


def _border(shape: tuple[int, ...]) -> BoolArray:
    border = np.ones(shape, dtype=np.bool_)
    border[1:-1, 1:-1, 1:-1] = False
    return border


def _parts_with_border(cells: BoolArray) -> BoolArray:
    """Return the cells that are connected with the border of the grid."""
    labels, _ = ndimage.label(cells)
    outside = np.unique(labels[_border(cells.shape)])
    return np.asarray(np.isin(labels, outside[outside > 0]))


def _neck(clearance: Array, core: BoolArray, outside: BoolArray, radius: float) -> Array:
    """Return the narrowest place (3,) of the shortest sufficiently wide path from a core to the outside."""
    way = clearance > radius - 0.5
    steps = np.where(core, 0, -1)
    front, count = core, 0
    while front.any() and not (front & outside).any():
        count += 1
        front = ndimage.binary_dilation(front) & way & (steps < 0)
        steps[front] = count
    place = np.argwhere(front & outside)[0] if (front & outside).any() else np.argwhere(core)[0]
    narrowest, least = place, np.inf
    while steps[tuple(place)] > 0:
        around = np.clip(place + _NEIGHBOURS, 0, np.array(steps.shape) - 1)
        place = next(each for each in around if steps[tuple(each)] == steps[tuple(place)] - 1)
        if clearance[tuple(place)] < least:
            narrowest, least = place, float(clearance[tuple(place)])
    return np.asarray(narrowest, dtype=float)


_DIRECTIONS: Final = 200  # number of directions of cuts across the channel, among which the shortest is used
_SHARES: Final = (-0.2, -0.1, 0.0, 0.1, 0.2)
"""Positions of the cuts, as multiples of the channel's width from its narrowest place."""
_OFFSETS: Final = 81  # number of cuts along the channel, within two widths of its narrowest place
_WIDER: Final = 1.1  # a cut longer than the shortest one by this factor lies outside the channel
_SHARE: Final = 0.7  # part of the channel that a plug fills; it is no thicker than the channel is wide


def without_channel(surface: SurfaceMesh, opening: OpenHollow) -> SurfaceMesh:
    """Return a closed surface without a piece of the wall of an opening's channel: with two flat open loops.

    Raises:
        MeshError: no plane cuts the channel in a closed line.
    """
    shortest, place, axis = np.inf, opening.place, np.zeros(3)
    for direction in _directions(_DIRECTIONS):
        for share in _SHARES:  # the narrowest place is known only to a cell of the grid
            base = opening.place + share * opening.width * direction
            cut = _cut(surface, base, direction)
            if cut is not None and cut[0] < shortest:
                shortest, place, axis = cut[0], base, direction
    if not np.isfinite(shortest):
        raise MeshError(
            surface.name, "no plane cuts the wall around its opening; close it in CAD with a plug"
        )
    offsets = opening.width * np.linspace(-2.0, 2.0, _OFFSETS)
    cuts = (_cut(surface, place + s * axis, axis) for s in offsets)
    narrow = np.array([cut is not None and cut[0] < _WIDER * shortest for cut in cuts])
    first = last = _OFFSETS // 2
    if narrow.any():
        nearest = min(np.flatnonzero(narrow), key=lambda each: abs(each - _OFFSETS // 2))
        runs, _ = ndimage.label(narrow)
        first, last = np.flatnonzero(runs == runs[nearest])[[0, -1]].tolist()
    thickness = min(_SHARE * (offsets[last] - offsets[first]), opening.width)
    middle = 0.5 * (offsets[first] + offsets[last])
    if thickness <= 0.0:
        raise MeshError(surface.name, "its opening has no channel to plug; close it in CAD with a plug")
    points, triangles = surface.points, surface.triangles
    lines = []
    for height in (middle - 0.5 * thickness, middle + 0.5 * thickness):
        base = place + height * axis
        cut = _cut(SurfaceMesh(points, triangles, surface.name), base, axis)
        assert cut is not None
        points, triangles, line = _split(points, triangles, cut[1], base, axis)
        lines.append(line)
    piece = _pieces(triangles, np.concatenate(lines))
    heights = (points[triangles].mean(axis=1) - place) @ axis - middle
    on_line = np.isin(triangles, np.concatenate(lines)).sum(axis=1) >= 2
    between = np.unique(piece[on_line & (np.abs(heights) < 0.5 * thickness)])
    return SurfaceMesh(points, triangles[~np.isin(piece, between)], surface.name)


def _directions(count: int) -> Array:
    """Return unit vectors spread over a hemisphere, shape (count, 3)."""
    z = (np.arange(count) + 0.5) / count
    angle = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(count)
    return np.column_stack([np.sqrt(1.0 - z**2) * np.cos(angle), np.sqrt(1.0 - z**2) * np.sin(angle), z])


def _cut(surface: SurfaceMesh, base: Array, normal: Array) -> tuple[float, IndexArray] | None:
    """Find the shortest closed line in which a plane cuts a surface around the point `base` (3,).

    Returns:
        Its length in [m] and the crossed triangles in order, shape (c,); None: there is no such line.
    """
    points, triangles = surface.points, surface.triangles
    above = (points - base) @ normal > 0.0
    crossed = np.flatnonzero(above[triangles].any(axis=1) & ~above[triangles].all(axis=1))
    if not len(crossed):
        return None
    edges, at = _crossed_edges(triangles[crossed], above)
    places = _places(points, edges, base, normal)
    number, label = connected(len(edges), at[:, 0], at[:, 1])
    u = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    u /= np.linalg.norm(u)
    flat = (places - base) @ np.column_stack([u, np.cross(normal, u)])
    angles = np.arctan2(flat[:, 1], flat[:, 0])
    turn = angles[at[:, 1]] - angles[at[:, 0]]
    turn = (turn + np.pi) % (2.0 * np.pi) - np.pi
    lengths = np.linalg.norm(places[at[:, 1]] - places[at[:, 0]], axis=1)
    of = label[at[:, 0]]
    total = np.bincount(of, weights=lengths, minlength=number)
    around = np.abs(np.bincount(of, weights=turn, minlength=number)) > np.pi
    if not around.any():
        return None
    best = int(np.where(around, total, np.inf).argmin())
    return float(total[best]), crossed[of == best]


def _crossed_edges(crossed: IndexArray, above: BoolArray) -> tuple[IndexArray, IndexArray]:
    """Return the edges (e, 2) that a plane crosses, and the two of each triangle in cut order, (c, 2)."""
    a, b, c = _from_tip(crossed, above)
    alone = above[a]
    entering = np.where(alone, b, c), np.where(alone, c, b)
    ends = np.sort(np.stack([np.column_stack([a, each]) for each in entering], axis=1), axis=2)
    edges, at = np.unique(ends.reshape(-1, 2), axis=0, return_inverse=True)
    return edges, at.reshape(-1, 2)


def _from_tip(crossed: IndexArray, above: BoolArray) -> tuple[IndexArray, IndexArray, IndexArray]:
    """Return the corners of crossed triangles (c, 3) in order, first the one alone on its side, each (c,)."""
    alone = above[crossed].sum(axis=1) == 1
    tip = np.where(alone[:, None], above[crossed], ~above[crossed]).argmax(axis=1)
    a, b, c = (np.take_along_axis(crossed, (tip[:, None] + k) % 3, axis=1).ravel() for k in range(3))
    return a, b, c


def _places(points: Array, edges: IndexArray, base: Array, normal: Array) -> Array:
    """Return the points where a plane crosses edges (e, 2), shape (e, 3)."""
    start, end = points[edges[:, 0]], points[edges[:, 1]]
    low, high = (start - base) @ normal, (end - base) @ normal
    return np.asarray(start + (low / (low - high))[:, None] * (end - start))


def _split(
    points: Array, triangles: IndexArray, which: IndexArray, base: Array, normal: Array
) -> tuple[Array, IndexArray, IndexArray]:
    """Cut triangles `which` in three along a plane; return points, triangles and the new points' numbers."""
    a, b, c = _from_tip(triangles[which], (points - base) @ normal > 0.0)
    ends = np.sort(np.concatenate([np.column_stack([a, b]), np.column_stack([a, c])]), axis=1)
    edges, at = np.unique(ends, axis=0, return_inverse=True)
    ab, ac = len(points) + at.reshape(2, -1)
    parts = [np.column_stack(each) for each in ((a, ab, ac), (ab, b, c), (ab, c, ac))]
    new = np.concatenate([np.delete(triangles, which, axis=0), *parts])
    return np.concatenate([points, _places(points, edges, base, normal)]), new, np.unique(np.append(ab, ac))


def _pieces(triangles: IndexArray, line: IndexArray) -> IndexArray:
    """Return the piece of each triangle after cutting edges between points of lines, shape (k,)."""
    edges = edges_of(triangles)
    of = edges.of.reshape(-1)
    remaining = ~np.isin(edges.ends, line).all(axis=1)[of]
    owner, size = np.repeat(np.arange(len(triangles)), 3)[remaining], len(triangles) + len(edges.ends)
    _, piece = connected(size, owner, len(triangles) + of[remaining])
    return piece[: len(triangles)]
