"""Repair of surfaces from CAD programs and scanners, or a report of problems and their places."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from softsim_core.base import Array, BoolArray, FormerAttribute, IndexArray, MeshError
from softsim_core.lab.meshing.part import SPECK, Nesting, Part, Unit, determine_nesting
from softsim_core.lab.meshing.topology import (
    areas,
    connected,
    edges_of,
    shells,
    touching_points,
    turned_alike,
)
from softsim_core.physics.mesh import SurfaceMesh

_LONG_LOOP = 400
"""Number of corners above which a hole is closed by a fan around its centre instead of by ear clipping."""


def hole_loops(triangles: IndexArray) -> list[IndexArray]:
    """Return the vertices around each hole of consistently oriented triangles (k, 3).

    They follow the direction of triangles that close the hole.
    """
    edges = edges_of(triangles)
    alone = edges.uses[edges.of] == 1
    start = triangles[alone]
    end = np.roll(triangles, -1, axis=1)[alone]
    onward: dict[int, list[int]] = {}
    for a, b in zip(end.tolist(), start.tolist(), strict=True):  # opposite to the triangles
        onward.setdefault(a, []).append(b)
    loops: list[IndexArray] = []
    for first in sorted(onward):
        while onward[first]:
            loops += _walk(first, onward)
    return loops


def _walk(first: int, onward: dict[int, list[int]]) -> list[IndexArray]:
    """Split a walk along open edges into simple loops; the edges are removed from `onward`."""
    loops, path, place = [], [first], {first: 0}
    while onward.get(path[-1]):
        following = onward[path[-1]].pop()
        if following in place:
            begin = place[following]
            loops.append(np.array(path[begin:], dtype=np.int64))
            for left in path[begin + 1 :]:
                del place[left]
            path = path[: begin + 1]
        else:
            place[following] = len(path)
            path.append(following)
    return [loop for loop in loops if len(loop) > 2]


def closing(points: Array, loop: IndexArray) -> tuple[Array, IndexArray]:
    """Triangulate a loop (c,) of points (n, 3), c >= 3.

    Returns:
        New vertices, which are numbered from n on, shape (0 or 1, 3), and triangles, shape (t, 3).
    """
    outline = _flatten_loop(points[loop])
    if len(loop) <= _LONG_LOOP:
        ears = _ears(outline)
        if ears is not None:
            return np.empty((0, 3)), loop[ears]
    middle = np.full(len(loop), len(points))
    return points[loop].mean(axis=0)[None], np.column_stack([loop, np.roll(loop, -1), middle])


def _flatten_loop(outline: Array) -> Array:
    """Project corners (c, 3) to the plane across the loop's area vector, counter-clockwise, shape (c, 2)."""
    off = outline - outline.mean(axis=0)
    normal = np.cross(off, np.roll(off, -1, axis=0)).sum(axis=0)
    length = np.linalg.norm(normal)
    if not length > 0.0:
        return np.zeros((len(outline), 2))
    normal /= length
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    first /= np.linalg.norm(first)
    return np.column_stack([off @ first, off @ np.cross(normal, first)])


def _ears(corners: Array) -> IndexArray | None:
    """Triangulate a simple polygon, counter-clockwise (c, 2); return None if it is not simple.

    Source: Meisters 1975, Polygons have ears. The roundest ear is cut first.
    """
    left, triangles = list(range(len(corners))), []
    slack = 1.0e-12 * float(np.ptp(corners, axis=0).max()) ** 2
    while len(left) > 3:
        ring = corners[left]
        before, after = np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0)
        twice = _cross(ring - before, after - ring)
        longest = ((after - before) ** 2).sum(axis=1)
        longest = np.maximum(longest, np.maximum(((ring - before) ** 2).sum(1), ((after - ring) ** 2).sum(1)))
        round_first = np.argsort(-twice / np.maximum(longest, 1e-300), kind="stable")
        for ear in round_first.tolist():
            if twice[ear] <= slack:
                return None
            others = np.delete(ring, [ear - 1, ear, (ear + 1) % len(left)], axis=0)
            if not _holds_any(before[ear], ring[ear], after[ear], others):
                break
        else:
            return None
        triangles.append([left[ear - 1], left[ear], left[(ear + 1) % len(left)]])
        del left[ear]
    return np.array([*triangles, left], dtype=np.int64)


def _holds_any(a: Array, b: Array, c: Array, others: Array) -> bool:
    inside = (_cross(b - a, others - a) >= 0.0) & (_cross(c - b, others - b) >= 0.0)
    return bool((inside & (_cross(a - c, others - c) >= 0.0)).any())


def _cross(u: Array, v: Array) -> Array:
    return np.asarray(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])


WELD = 1.0e-6
"""Corners closer than this part of the part's diagonal are merged."""
HOLE = 0.05
"""Default of the largest hole to close, as a part of the longest side."""
_FLAT = 1.0e-12  # a triangle with a smaller area, relative to its longest side squared, counts as degenerate
_THIN = 1.0e-9  # a surface that encloses a smaller part of its diagonal cubed encloses nothing
_MOST_HOLES = 200


@dataclass(frozen=True, slots=True, eq=False)
class RepairedSurface:
    """A closed surface.

    Attributes:
        surface: In [m], solids outward, cavities into the cavity.
        unit: Unit of its file.
        remarks: Messages about repairs and unusual properties, in order.
        volume: Volume inside in [m^3], without cavities.
        crosses: Whether it intersects itself: then the volume counts overlaps twice.
        cavities: Number of cavities.
    """

    surface: SurfaceMesh
    unit: Unit
    remarks: tuple[str, ...]
    told = FormerAttribute("remarks")
    volume: float
    crosses: bool
    cavities: int


def repair_part(
    part: Part,
    hole: float | None = None,
    largest: bool = False,
    simplify: Callable[[SurfaceMesh], SurfaceMesh] | None = None,
) -> RepairedSurface:
    """Repair a part's triangles to a closed surface.

    Corners at one place are merged. Degenerate triangles, duplicates and loose flaps are removed. Holes are
    closed. Each shell is oriented outward, or into the cavity if it lies in another one.

    Args:
        part: The part as read from its file.
        hole: Largest hole in [m] to close; None: HOLE of the longest side.
        largest: Use only the largest body if there are several.
        simplify: Function that reduces the triangles of a closed surface with very many.

    Raises:
        MeshError: the surface is open, has one side only, walls that end inside or several bodies, or it
            encloses nothing; says where, in the file's unit.
    """
    name, unit = part.surface.name, part.unit
    points, remarks = part.surface.points, list(part.remarks)
    size = np.ptp(points, axis=0)
    points, triangles, words = _clean(points, part.surface.triangles, WELD * float(np.linalg.norm(size)))
    remarks += words
    _refuse_walls(points, triangles, name, unit)
    triangles, turned, one_sided = turned_alike(triangles)
    if len(one_sided):
        where = unit.place(points[one_sided[0]].mean(axis=0))
        raise MeshError(
            name,
            f"is a surface with one side only (like a Moebius strip): at {where} its triangles cannot be "
            "turned alike; model a body with a thickness",
        )
    if turned:
        remarks.append(f"turned {turned} of {len(triangles)} triangles, which looked the other way")
    points, triangles, words = _close_holes(
        points, triangles, HOLE * float(size.max()) if hole is None else hole, name, unit
    )
    remarks += words
    if simplify is not None:
        surface = SurfaceMesh(points, triangles, name)
        fewer = simplify(surface)
        if fewer is not surface:
            remarks.append(f"took {len(fewer.triangles)} triangles for its {len(triangles)}")
            points, triangles, _ = _clean(fewer.points, fewer.triangles, 0.0)
            triangles, _, _ = turned_alike(triangles)
            points, triangles, _ = _close_holes(points, triangles, float("inf"), name, unit)
    return _bodies(points, triangles, replace(part, remarks=tuple(remarks)), largest)


def _bodies(points: Array, triangles: IndexArray, part: Part, largest: bool) -> RepairedSurface:
    """Select the shells to use and determine their nesting."""
    name, unit, remarks = part.surface.name, part.unit, list(part.remarks)
    found = determine_nesting(points, triangles)
    usable = found.diagonals > SPECK * found.diagonals.max()
    usable &= found.volumes > _THIN * found.diagonals**3
    if not usable.any():
        raise MeshError(
            name,
            f"encloses no volume: its {len(triangles)} triangles, {unit.size(np.ptp(points, axis=0))}, are a "
            "sheet without thickness; model a body with a thickness",
        )
    if not usable.all():
        remarks.append(f"left out {_count(int((~usable).sum()), 'shell')} with next to nothing inside")
    bodies = np.unique(found.body[usable & ~found.cavities])
    if len(bodies) > 1:
        sizes = np.array([found.volumes[usable & (found.body == each)].max() for each in bodies])
        if not largest:
            raise MeshError(name, _several(points, found, bodies[np.argsort(-sizes)[:2]], len(bodies), unit))
        remarks.append(f"kept the largest of {len(bodies)} bodies that no face joins")
        bodies = bodies[[int(sizes.argmax())]]
    usable &= np.isin(found.body, bodies)
    chosen = usable[found.label]
    cavities = int((usable & found.cavities).sum())
    if cavities:
        remarks.append(f"{_count(cavities, 'hollow')} inside")
    if found.turned:
        remarks.append(f"turned {_count(found.turned, 'shell')} of {len(usable)} inside out")
    crossing = found.crossing[chosen[found.crossing].all(axis=1)]
    if len(crossing):
        where = unit.place(points[found.triangles[crossing[0][0]]].mean(axis=0))
        remarks.append(
            f"passes through itself at {_count(len(crossing), 'pair')} of triangles, the first at {where}"
        )
    used, numbers = np.unique(found.triangles[chosen], return_inverse=True)
    faces = np.ascontiguousarray(numbers.reshape(-1, 3), dtype=np.int64)
    pinched = touching_points(faces)
    if len(pinched):
        where = unit.place(points[used][pinched[0]])
        remarks.append(f"touches itself in {_count(len(pinched), 'point')}, the first at {where}")
    volume = float(np.where(found.cavities, -found.volumes, found.volumes)[usable].sum())
    surface = SurfaceMesh(np.ascontiguousarray(points[used]), faces, name)
    return RepairedSurface(surface, unit, tuple(remarks), volume, len(crossing) > 0, cavities)


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def _several(points: Array, found: Nesting, two: IndexArray, count: int, unit: Unit) -> str:
    said = []
    for body in two.tolist():
        own = points[np.unique(found.triangles[found.body[found.label] == body])]
        said.append(f"{unit.size(np.ptp(own, axis=0))} around {unit.place(own.mean(axis=0))}")
    return (
        f"holds {count} bodies that no face joins, the largest of them {said[0]} and {said[1]}; join them in "
        "the CAD program, export each into a file of its own, or keep the largest alone with --largest"
    )


def _clean(points: Array, triangles: IndexArray, weld: float) -> tuple[Array, IndexArray, list[str]]:
    """Merge points, and remove degenerate, duplicate and loose triangles."""
    remarks: list[str] = []
    points, numbers = _weld_points(points, weld)
    if len(numbers) > len(points):
        remarks.append(f"welded {_count(len(numbers) - len(points), 'corner')} to others at the same place")
    triangles = numbers[triangles]
    whole = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    if not whole.all():
        remarks.append(f"dropped {_count(int((~whole).sum()), 'triangle')} with two corners in one place")
    triangles = triangles[whole]
    _, first, group, count = np.unique(
        np.sort(triangles, axis=1), axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    repeated = len(triangles) - len(first)
    if repeated:
        # opposite twins are a wall between two bodies, or a triangle that was written twice
        once = np.isin(np.arange(len(triangles)), first)
        triangles = _less_odd(triangles, [once, (count == 1)[group.reshape(-1)]])
        remarks.append(f"dropped {_count(repeated, 'triangle')} for repeating others")
    corners = points[triangles]
    longest = ((corners - np.roll(corners, 1, axis=1)) ** 2).sum(axis=2).max(axis=1, initial=0.0)
    flat = areas(points, triangles) <= _FLAT * longest
    if flat.any():
        before = len(triangles)
        triangles = _less_odd(triangles, [np.ones(len(triangles), dtype=bool), ~flat])
        if len(triangles) < before:
            remarks.append(f"dropped {_count(before - len(triangles), 'triangle')} without area")
        else:
            remarks.append(f"kept {_count(int(flat.sum()), 'triangle')} without area, which close gaps")
    triangles, flaps = _without_flaps(triangles)
    if flaps:
        remarks.append(f"dropped {_count(flaps, 'triangle')} hanging loose at an edge")
    return points, triangles, remarks


def _weld_points(points: Array, distance: float) -> tuple[Array, IndexArray]:
    """Merge points closer than a distance; return the points and the new number of each old one."""
    pairs = (
        cKDTree(points).query_pairs(distance, output_type="ndarray")
        if distance > 0.0
        else np.empty((0, 2), dtype=np.int64)
    )
    _, label = connected(len(points), *pairs.T)
    _, first, numbers = np.unique(label, return_index=True, return_inverse=True)
    return points[first], numbers.reshape(-1).astype(np.int64)


def _less_odd(triangles: IndexArray, choices: list[BoolArray]) -> IndexArray:
    """Return the choice of triangles with the fewest edges of odd use count, the first of equals."""
    odd = [int(edges_of(triangles[choice]).odd.sum()) for choice in choices]
    return np.asarray(triangles[choices[int(np.argmin(odd))]])


def _without_flaps(triangles: IndexArray) -> tuple[IndexArray, int]:
    """Remove triangles with both an open edge and an edge of three triangles, repeatedly; return how many."""
    before = len(triangles)
    while True:
        edges = edges_of(triangles)
        loose = (edges.uses[edges.of] == 1).any(axis=1)
        loose &= ((edges.uses[edges.of] > 2) & edges.odd[edges.of]).any(axis=1)
        if not loose.any():
            return triangles, before - len(triangles)
        triangles = triangles[~loose]


def _refuse_walls(points: Array, triangles: IndexArray, name: str, unit: Unit) -> None:
    if not len(triangles):
        raise MeshError(
            name,
            "has no triangle that bounds a volume (a sheet that is drawn from both sides does not); "
            "model a body with a thickness",
        )
    edges = edges_of(triangles)
    walls = np.flatnonzero((edges.uses > 2) & edges.odd)
    if len(walls):
        where = unit.place(points[edges.ends[walls[0]]].mean(axis=0))
        raise MeshError(
            name,
            f"{len(walls)} edges belong to three triangles or another odd number, the first at {where}: a "
            "wall ends there inside the part; join the bodies in the CAD program (union) and export again",
        )


def _close_holes(
    points: Array, triangles: IndexArray, hole: float, name: str, unit: Unit
) -> tuple[Array, IndexArray, list[str]]:
    """Close holes up to a size in [m] with triangles."""
    loops = hole_loops(triangles)
    if not loops:
        _refuse_unbalanced(points, triangles, name, unit)
        return points, triangles, []
    sizes = np.array([np.linalg.norm(np.ptp(points[loop], axis=0)) for loop in loops])
    worst = int(sizes.argmax())
    where, across = unit.place(points[loops[worst]].mean(axis=0)), unit.length(sizes[worst])
    many = f"{len(loops)} holes, the largest" if len(loops) > 1 else "a hole"
    if sizes[worst] > hole:
        raise MeshError(
            name,
            f"is open: {many} of {across} across around {where}; close it in the CAD program, or, if it "
            f"shall be covered by flat triangles, allow --holes {1.01 * sizes[worst] / unit.metres:.3g} "
            f"({unit.name}; up to {unit.length(hole)} are closed by themselves)",
        )
    if len(loops) > _MOST_HOLES:
        raise MeshError(
            name,
            f"has {many} of {across} across around {where}: its triangles do not fit together; export the "
            "part again with a coarser tolerance",
        )
    for loop in loops:
        more, cover = closing(points, loop)
        points, triangles = np.concatenate([points, more]), np.concatenate([triangles, cover])
    _refuse_unbalanced(points, triangles, name, unit)
    return points, triangles, [f"closed {many} of {across} across around {where}"]


def _refuse_unbalanced(points: Array, triangles: IndexArray, name: str, unit: Unit) -> None:
    """Raise an error for shells that are not closed by themselves."""
    _, label = shells(triangles)
    edges = edges_of(triangles + len(points) * label[:, None])
    left = np.flatnonzero(edges.odd | edges.unbalanced)
    if len(left):
        where = unit.place(points[edges.ends[left[0]] % len(points)].mean(axis=0))
        raise MeshError(
            name,
            f"has triangles that do not fit together at {len(left)} edges, the first at {where}: more than "
            "two pieces of surface meet there; repair it in the CAD program",
        )
