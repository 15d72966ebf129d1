"""Mesh of the maze plate from a text picture: walls on a square plate with a floor at z = 0.

Lines and columns of the picture alternate between thin walls and wide corridors; `#` is wall, `.` is floor.
The picture's right is +x, its top +y.

`python -m softsim_core.robots.maze_mesh --picture configs/meshes/maze.txt --out configs/meshes/maze.stl`
writes the file that the maze scene names.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from softsim_core.base import MILLIMETRE, Array, BoolArray, MeshError
from softsim_core.physics.mesh import SurfaceMesh, merge_corners, write_surface

EDGE = 60.0 * MILLIMETRE
"""Edge length of the plate in [m]; its centre is the origin."""
WALL = 1.0 * MILLIMETRE
"""Thickness of walls in [m]."""
UNDERSIDE, FLOOR, TOP = -2.0 * MILLIMETRE, 0.0, 3.9 * MILLIMETRE
"""Heights in [m]."""


def maze_plate(picture: str, name: str = "maze") -> SurfaceMesh:
    """Return the closed surface of a maze plate.

    Args:
        picture: Lines of `#` and `.`, as many as each is long, an odd number; walls all around.
        name: Name of the mesh.

    Returns:
        Outward surface in [m].

    Raises:
        MeshError: the picture shows no maze, or walls touch only at a corner; names the line.
    """
    walls = read_picture(picture, name)
    lines: list[float] = grid_lines(len(walls)).tolist()
    corners: list[Array] = []

    def square(a: Sequence[float], b: Sequence[float], c: Sequence[float], d: Sequence[float]) -> None:
        corners.append(np.array([a, b, c, a, c, d]))

    for (i, j), wall in np.ndenumerate(walls):
        x, y, right, above = lines[i], lines[j], lines[i + 1], lines[j + 1]
        height = TOP if wall else FLOOR
        square((x, y, height), (right, y, height), (right, above, height), (x, above, height))
        square((x, above, UNDERSIDE), (right, above, UNDERSIDE), (right, y, UNDERSIDE), (x, y, UNDERSIDE))
        sides = (
            ((i - 1, j), (x, above), (x, y)),
            ((i + 1, j), (right, y), (right, above)),
            ((i, j - 1), (x, y), (right, y)),
            ((i, j + 1), (right, above), (x, above)),
        )
        for neighbour, start, end in sides:
            inside = min(neighbour) >= 0 and max(neighbour) < len(walls)
            if wall and not (inside and walls[neighbour]):
                square((*start, FLOOR), (*end, FLOOR), (*end, TOP), (*start, TOP))
            if not inside:
                square((*start, UNDERSIDE), (*end, UNDERSIDE), (*end, FLOOR), (*start, FLOOR))
    points, triangles = merge_corners(np.concatenate(corners))
    return SurfaceMesh(points, triangles, name)


def read_picture(picture: str, name: str = "maze") -> BoolArray:
    """Return whether each cell is wall, by column from the left and line from the bottom, shape (n, n).

    Raises:
        MeshError: as `maze_plate`.
    """
    rows = picture.split()
    size = len(rows)
    if size < 3 or size % 2 == 0:
        raise MeshError(name, f"a maze needs an odd number of lines >= 3, not {size}")
    for number, row in enumerate(rows, start=1):
        if len(row) != size or set(row) - set("#."):
            raise MeshError(name, f"line {number}: needs {size} of # and ., not {row!r}")
    walls = np.array([[mark == "#" for mark in row] for row in reversed(rows)]).T
    if not (walls[[0, -1]].all() and walls[:, [0, -1]].all()):
        raise MeshError(name, "a maze needs walls all around")
    a, b, c, d = walls[:-1, :-1], walls[1:, 1:], walls[1:, :-1], walls[:-1, 1:]
    touching = np.argwhere((a & b & ~c & ~d) | (c & d & ~a & ~b))
    if len(touching):
        line = size - int(touching[0, 1])
        raise MeshError(name, f"lines {line - 1} and {line}: walls touch at a corner only; join them")
    return np.asarray(walls)


def grid_lines(size: int) -> Array:
    """Return coordinates in [m] of the lines between the cells of a picture, from -EDGE / 2 to EDGE / 2."""
    corridors = size // 2
    widths = np.full(size, (EDGE - (corridors + 1) * WALL) / corridors)
    widths[::2] = WALL
    return np.concatenate([[0.0], np.cumsum(widths)]) - 0.5 * EDGE


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line: write the maze of a picture."""
    parser = argparse.ArgumentParser(prog="python -m softsim_core.robots.maze_mesh", description=main.__doc__)
    parser.add_argument("--picture", type=Path, default=Path("configs/meshes/maze.txt"), help="text file")
    parser.add_argument(
        "-o", "--out", type=Path, default=Path("configs/meshes/maze.stl"), help="file to write"
    )
    chosen = parser.parse_args(arguments)
    try:
        write_surface(chosen.out, maze_plate(chosen.picture.read_text(encoding="utf-8"), chosen.picture.name))
    except (MeshError, OSError, UnicodeDecodeError) as error:
        parser.exit(1, f"{error}\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
