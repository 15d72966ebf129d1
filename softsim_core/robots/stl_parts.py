"""Three parts as a CAD program would export them, in mm: to try `softsim mesh` and `softsim new` with.

Each is made of blocks of a grid, some full and some empty, that is bent into its shape. They stand on z = 0.

`python -m softsim_core.robots.stl_parts --out configs/parts` writes them.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np

from softsim_core.base import Array, BoolArray
from softsim_core.physics.mesh import SurfaceMesh, merge_corners, write_surface

_ROUND = 1.0e-6
"""Corners closer than this in [mm] are merged."""


def blocks(
    full: BoolArray, corner: Callable[[Array, Array, Array], Array], name: str, around: bool = False
) -> SurfaceMesh:
    """Return the surface of the full blocks of a grid.

    Args:
        full: Whether each block is full, shape (a, b, c).
        corner: Map of grid points: three arrays of grid coordinates to positions (..., 3).
        name: Name of the surface.
        around: Whether the grid is periodic along the first axis.
    """
    padded = np.pad(full, 1)
    if around:
        padded[[0, -1], 1:-1, 1:-1] = full[0]
    quads = []
    for axis in range(3):
        count = padded.shape[axis] - 1
        after, before = (np.take(padded, range(start, start + count), axis) for start in (1, 0))
        for ends, out in ((before & ~after, True), (after & ~before, False)):
            at = np.argwhere(ends) - 1.0  # in grid coordinates; along the axis those of the face
            at[:, axis] += 1.0
            if around and axis > 0:  # padding repeats the first and the last blocks
                at = at[(at[:, 0] >= 0.0) & (at[:, 0] < len(full))]
            u, v = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
            square = np.stack([at, at + u, at + u + v, at + v], axis=1)
            quads.append(square if out else square[:, ::-1])
    grid = np.concatenate(quads)
    places = np.round(corner(grid[..., 0], grid[..., 1], grid[..., 2]) / _ROUND) * _ROUND
    points, triangles = merge_corners(places[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3))
    whole = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    return SurfaceMesh(points, triangles[whole], name)


def fin_ray_finger() -> SurfaceMesh:
    """Return two walls that meet at the tip, with ribs in between: the finger bends around a contact."""
    width, depth, height, wall, rib, ribs = 20.0, 30.0, 100.0, 3.0, 2.5, 5
    gap = (height - 15.0 - (ribs + 1) * rib) / ribs
    levels = np.concatenate([[0.0], np.cumsum([rib, gap] * ribs + [rib + 15.0])])
    full = np.ones((3, 1, len(levels) - 1), dtype=bool)
    full[1, 0, 1:-1:2] = False  # the windows

    def corner(i: Array, j: Array, k: Array) -> Array:
        z = levels[k.astype(int)]
        back = depth - (depth - 2.0 * wall - 2.0) * z / height  # leans to the front wall
        x = np.select([i == 0, i == 1, i == 2], [0.0 * z, wall + 0.0 * z, back - wall], back)
        return np.stack([x, width * j, z], axis=-1)

    return blocks(full, corner, "fin_ray_finger")


def bellows() -> SurfaceMesh:
    """Return a tube with four folds and closed ends: the cavity inside is an air chamber."""
    around, folds, steps, wall, cap, pitch = 24, 4, 6, 2.0, 4.0, 12.0
    levels = np.concatenate([[0.0], cap + pitch * folds * np.linspace(0.0, 1.0, folds * steps + 1)])
    levels = np.append(levels, levels[-1] + cap)
    full = np.ones((around, 2, len(levels) - 1), dtype=bool)
    full[:, 0, 1:-1] = False

    def corner(i: Array, j: Array, k: Array) -> Array:
        z = levels[k.astype(int)]
        phase = 2.0 * np.pi * np.clip((z - cap) / pitch, 0.0, folds)
        outer = 10.0 + 4.0 * (1.0 - np.cos(phase)) / 2.0
        radius = np.select([j == 0, j == 1], [0.0 * z, outer - wall], outer)
        angle = -2.0 * np.pi * (i % around) / around  # right-handed
        return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=-1)

    return blocks(full, corner, "bellows", around=True)


def lattice_gripper() -> SurfaceMesh:
    """Return a finger of struts that leans forward, on a plate: 3 x 2 posts with rungs, closed at the tip."""
    strut, gap, storeys = 3.0, 7.0, 6
    sizes = [
        [strut, gap, strut, gap, strut],
        [strut, gap, strut],
        [4.0, *[gap, strut] * (storeys - 1), gap, 4.0],
    ]
    lines = [np.concatenate([[0.0], np.cumsum(each)]) for each in sizes]
    i, j, k = np.meshgrid(*(np.arange(len(each)) for each in sizes), indexing="ij")
    full = (i % 2 == 0).astype(int) + (j % 2 == 0) + (k % 2 == 0) >= 2
    full[:, :, [0, -1]] = True

    def corner(i: Array, j: Array, k: Array) -> Array:
        x, y, z = (line[at.astype(int)] for line, at in zip(lines, (i, j, k), strict=True))
        share = z / lines[2][-1]
        return np.stack([x * (1.0 - 0.35 * share) + 12.0 * share**2, y, z], axis=-1)

    return blocks(full, corner, "lattice_gripper")


PARTS = (fin_ray_finger, bellows, lattice_gripper)


def main() -> int:
    """Write the files."""
    parser = argparse.ArgumentParser(prog="python -m softsim_core.robots.stl_parts", description=__doc__)
    parser.add_argument("-o", "--out", type=Path, default=Path("configs/parts"), help="folder to write into")
    folder: Path = parser.parse_args().out
    for make in PARTS:
        surface = make()
        write_surface(folder / f"{surface.name}.stl", surface, "mm")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
