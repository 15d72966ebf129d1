"""Hollows that are open to the outside through a narrow opening, such as an air inlet.

The part is sampled on a grid. Where growing it by a clearance r cuts a wide hollow off from the outside, the
way between them is at most 2 r wide: its narrowest place is the opening.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from scipy import ndimage

from softsim_core.arrays import Array, BoolArray, IndexArray
from softsim_core.mesh.types import SurfaceMesh

CELLS: Final = 72
"""Cells of the grid along the longest side."""
_NARROW: Final = 0.6
"""An opening is at most so wide, of the hollow's width behind it."""
_LARGE: Final = 0.02
"""A hollow has at least this share of the volume of the part's box."""
_NEIGHBOURS: Final = np.concatenate([np.eye(3, dtype=int), -np.eye(3, dtype=int)])
_MOST: Final = 3
"""More hollows than this are a lattice and no air chambers."""


class OpenHollow(NamedTuple):
    """A hollow with an opening.

    Attributes:
        place: Where its opening is narrowest, in [m], shape (3,).
        width: How wide it is there in [m], to about a cell of the grid.
        volume: Of the hollow in [m^3], about.
    """

    place: Array
    width: float
    volume: float


def open_hollows(surface: SurfaceMesh) -> tuple[OpenHollow, ...]:
    """Find the hollows of a part that narrow openings join with the outside, the largest first.

    An opening narrower than two cells of the grid may be missed.

    Args:
        surface: Closed, outward, in [m].
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
    known = np.zeros_like(free)
    joined = free & (_parts_with_border(free))
    widest = float(clearance[np.isfinite(clearance)].max())
    for radius in np.arange(1.5, widest, 0.5).tolist():
        apart = clearance > radius
        outside = _parts_with_border(apart)
        labels, count = ndimage.label(apart & ~outside & joined & ~known)
        for number in range(1, count + 1):
            core = labels == number
            wide = float(clearance[core].max())
            hollow = joined & (ndimage.distance_transform_edt(~core) <= radius)
            if radius > _NARROW * wide or hollow.sum() < _LARGE * np.prod(size / cell):
                continue
            neck = _neck(clearance, core, outside, radius)
            known |= hollow
            place = origin + cell * neck
            found.append(OpenHollow(place, 2.0 * cell * radius, float(hollow.sum()) * cell**3))
    return tuple(sorted(found, key=lambda each: -each.volume)) if len(found) <= _MOST else ()


def _inside(points: Array, triangles: IndexArray, shape: tuple[int, int, int]) -> BoolArray:
    """Whether the middle of each cell (unit cubes at whole numbers) lies inside a closed surface."""
    corners = points[triangles] + [1.3e-5, 2.7e-5, 0.0]  # so that no edge passes through a middle
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
    """The cells that are joined with the border of the grid."""
    labels, _ = ndimage.label(cells)
    outside = np.unique(labels[_border(cells.shape)])
    return np.asarray(np.isin(labels, outside[outside > 0]))


def _neck(clearance: Array, core: BoolArray, outside: BoolArray, radius: float) -> Array:
    """The narrowest place of the shortest way from a core to the outside that is wide enough, shape (3,)."""
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
