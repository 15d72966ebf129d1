"""Surfaces for the tests of meshing, in the unit of their files, and STL files of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from softsim_core.base import Array, IndexArray
from softsim_core.physics.mesh import box_surface, cylinder_surface, rotation_matrix, sphere_surface

Surface = tuple[Array, IndexArray]


def box(x: float = 20.0, y: float = 20.0, z: float = 20.0, divisions: int = 1) -> Surface:
    made = box_surface((x, y, z), divisions)
    return made.points, made.triangles


def ball(radius: float = 10.0, refinements: int = 2) -> Surface:
    made = sphere_surface(radius, refinements)
    return made.points, made.triangles


def rod(radius: float = 5.0, height: float = 40.0, segments: int = 24) -> Surface:
    made = cylinder_surface(radius, height, segments)
    return made.points, made.triangles


def lattice(columns: int, rows: int, closed_columns: bool = False, closed_rows: bool = False) -> IndexArray:
    """Triangles between columns x rows of points, numbered row by row."""
    number = np.arange(columns * rows).reshape(rows, columns)
    if closed_columns:
        number = np.column_stack([number, number[:, 0]])
    if closed_rows:
        number = np.vstack([number, number[:1]])
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    return np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])


def torus(large: float = 15.0, small: float = 4.0, around: int = 48, across: int = 16) -> Surface:
    v, u = np.meshgrid(
        2 * np.pi * np.arange(around) / around, 2 * np.pi * np.arange(across) / across, indexing="ij"
    )
    radius = large + small * np.cos(u)
    points = np.stack([radius * np.cos(v), radius * np.sin(v), small * np.sin(u)], axis=-1).reshape(-1, 3)
    triangles = lattice(across, around, True, True)
    return points, triangles[:, ::-1]


def bottle(inlet: float, outer: float = 20.0, inner: float = 15.0, height: float = 60.0) -> Surface:
    """A thick-walled bottle that stands on z = 0; `inlet` is the radius of the hole in its 4 mm thick top."""
    wall, segments = 4.0, 48
    radii = np.array([outer, outer, inlet, inlet, inner, inner])
    heights = np.array([0.0, height, height, height - wall, height - wall, wall])
    angles = 2 * np.pi * np.arange(segments) / segments
    x, y = radii[:, None] * np.cos(angles), radii[:, None] * np.sin(angles)
    rings = np.stack([x, y, np.repeat(heights[:, None], segments, axis=1)], axis=-1).reshape(-1, 3)
    first, last = np.arange(segments), np.arange(segments) + segments * (len(radii) - 1)
    middles = np.full(segments, len(rings)), np.full(segments, len(rings) + 1)
    triangles = [
        lattice(segments, len(radii), closed_columns=True),
        np.column_stack([np.roll(first, -1), first, middles[0]]),
        np.column_stack([last, np.roll(last, -1), middles[1]]),
    ]
    return np.vstack([rings, [0.0, 0.0, 0.0], [0.0, 0.0, wall]]), np.concatenate(triangles)


def sheet(size: float = 20.0, cells: int = 6) -> Surface:
    line = np.linspace(0.0, size, cells + 1)
    x, y = np.meshgrid(line, line)
    return np.stack([x, y, 0.1 * x], axis=-1).reshape(-1, 3), lattice(cells + 1, cells + 1)


def moebius(radius: float = 20.0, width: float = 8.0, around: int = 60) -> Surface:
    """A strip of four triangles' breadth, glued with a half turn."""
    across = 5
    v = 2 * np.pi * np.arange(around) / around
    s = np.linspace(-0.5 * width, 0.5 * width, across)
    r = radius + s[None] * np.cos(0.5 * v)[:, None]
    points = np.stack(
        [r * np.cos(v)[:, None], r * np.sin(v)[:, None], s[None] * np.sin(0.5 * v)[:, None]], axis=-1
    ).reshape(-1, 3)
    triangles = lattice(across, around + 1)
    last = triangles >= across * around  # the row after the last is the first one, the other way round
    return points, np.where(last, across - 1 - (triangles - across * around), triangles)


def joined(*surfaces: Surface) -> Surface:
    points, triangles, count = [], [], 0
    for each, faces in surfaces:
        points.append(each)
        triangles.append(faces + count)
        count += len(each)
    return np.concatenate(points), np.concatenate(triangles)


def moved(surface: Surface, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Surface:
    return surface[0] + np.array([x, y, z]), surface[1]


def tilted(surface: Surface, *angles_deg: float) -> Surface:
    return surface[0] @ rotation_matrix(angles_deg).T, surface[1]


def inside_out(surface: Surface) -> Surface:
    return surface[0], surface[1][:, ::-1]


def without(surface: Surface, *numbers: int) -> Surface:
    return surface[0], np.delete(surface[1], numbers, axis=0)


def pinched_ring() -> Surface:
    """Seven of nine cubes in a square: the hollow in the middle meets the missing corner in an edge."""
    cubes = [(x, y) for x in range(3) for y in range(3) if (x, y) not in ((1, 1), (2, 2))]
    return joined(*(moved(box(5, 5, 5), 5.0 * x, 5.0 * y) for x, y in cubes))


def volume(surface: Surface) -> float:
    """Signed volume inside, by the divergence theorem."""
    return float(np.linalg.det(surface[0][surface[1]]).sum() / 6.0)


def stl(surface: Surface) -> bytes:
    """Binary STL, in the unit of the points."""
    facets = np.zeros(len(surface[1]), np.dtype([("vectors", "<f4", (4, 3)), ("attribute", "<u2")]))
    facets["vectors"][:, 1:] = surface[0][surface[1]]
    return b"a part".ljust(80) + np.uint32(len(facets)).astype("<u4").tobytes() + facets.tobytes()


def text_stl(surface: Surface, number: str = "{:.6f}") -> bytes:
    lines = ["solid part"]
    for corners in surface[0][surface[1]]:
        lines += ["facet normal 0 0 0", " outer loop"]
        lines += ["  vertex " + " ".join(number.format(x) for x in corner) for corner in corners]
        lines += [" endloop", "endfacet"]
    return "\n".join([*lines, "endsolid part", ""]).encode()


def write(folder: Path, surface: Surface | bytes, name: str = "part.stl") -> Path:
    file = folder / name
    file.write_bytes(surface if isinstance(surface, bytes) else stl(surface))
    return file
