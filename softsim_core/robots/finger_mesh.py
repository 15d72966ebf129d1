"""Mesh of the cable gripper's finger from its profile: a spine with three blocks and two V notches.

The profile is divided into columns of points across the spine, connected to triangles and swept across the
finger's width. In the finger's own frame the width is along x, the finger along -y from its base at y = 0,
and its inner, notched side faces +z.

`python -m softsim_core.robots.finger_mesh --out configs/meshes` writes the files that the gripper's config
names.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np

from softsim_core.base import MILLIMETRE, Array, IndexArray, MeshError
from softsim_core.physics.mesh import TetMesh, extrude, flip_to_delaunay, smooth, stitch
from softsim_core.robots.tripod_mesh import write_mesh_files

WIDTH = 15.0 * MILLIMETRE
"""Width in [m]; the finger lies from x = 0 to x = WIDTH."""
SPINE = 5.0 * MILLIMETRE
"""Thickness in [m] of the spine, and of the tongue at the base."""
HEIGHT = 15.0 * MILLIMETRE
"""Height in [m] of the blocks."""
TONGUE = 10.0 * MILLIMETRE
"""Length in [m] of the tongue before the first block."""
PLATEAU = 15.0 * MILLIMETRE
"""Length in [m] of a block's flat top."""
SLANT = (HEIGHT - SPINE) * math.tan(math.radians(37.5))
"""Length in [m] along the finger of a notch wall; two of them make a V of 75 degrees."""
BLOCKS = 3
TIP_RADIUS = HEIGHT - SPINE
"""Radius in [m] of the round corner at the tip."""
LENGTH = TONGUE + BLOCKS * PLATEAU + (2 * BLOCKS - 1) * SLANT + TIP_RADIUS
"""Length in [m]: 103.366 mm."""
WALL_KNEE = 0.4
"""Part of a notch wall's height with a row of nodes on every level; collision surfaces begin there."""
NOTCH_DEPTH = HEIGHT - SPINE
"""Depth in [m] of the notches between the blocks."""
THINNEST = 2.0 * MILLIMETRE
"""Least remaining thickness in [m] of the spine below a notch, and of the notch itself."""

LEVELS: dict[str, int] = {"coarse": 0, "low": 1, "mid": 2}
"""Elements through the spine by level name; 0: as few as the profile allows, for quadratic elements."""


def finger(divisions: int = 1, name: str = "finger", notch_depth: float = NOTCH_DEPTH) -> TetMesh:
    """Mesh the finger in its own frame, symmetric by reflection in the middle of its width.

    Args:
        divisions: Elements through the spine, twice as many across the width; 0: one element through both,
            two through the blocks.
        name: Name of the mesh.
        notch_depth: Depth of the notches between the blocks in [m]. Their width is constant, so deeper
            notches have a smaller angle.

    Returns:
        Positively oriented tetrahedra in [m].

    Raises:
        MeshError: divisions is negative, or less than THINNEST is left of a notch or of the spine below.
    """
    if divisions < 0:
        raise MeshError(name, f"divisions = {divisions} must be >= 0")
    if not THINNEST <= notch_depth <= HEIGHT - THINNEST:
        allowed = f"{THINNEST:g} to {HEIGHT - THINNEST:g} m"
        raise MeshError(name, f"notch_depth = {notch_depth} must lie from {allowed}")
    plane, triangles = profile(divisions, notch_depth)
    heights = np.linspace(0.0, WIDTH, max(1, 2 * divisions) + 1)
    solid, tets = extrude(plane, triangles, np.arange(len(plane)), heights)
    return TetMesh(np.ascontiguousarray(solid[:, [2, 0, 1]]), tets, name)


def profile(divisions: int, notch_depth: float = NOTCH_DEPTH) -> tuple[Array, IndexArray]:
    """Triangulate the side view of the finger: along the finger (negative) and up.

    Args:
        divisions: See `finger`.
        notch_depth: See `finger`.

    Returns:
        Points in [m], shape (n, 2), and counter-clockwise triangles, shape (k, 3).
    """
    points: list[tuple[float, float]] = []
    columns: list[list[int]] = []
    for along, top in _stations(divisions, HEIGHT - notch_depth):
        rows = max(1, round(divisions * top / SPINE) if divisions else min(2, round(top / SPINE)))
        columns.append(list(range(len(points), len(points) + rows + 1)))
        points.extend((-along, top * row / rows) for row in range(rows + 1))
    plane = np.array(points)
    pairs = itertools.pairwise(columns)
    triangles = [triangle for nearer, farther in pairs for triangle in stitch(plane, farther, nearer)]
    movable = np.zeros((len(plane), 2, 2))
    for column in columns[1:-1]:
        movable[column[1:-1]] = np.eye(2)
    for _ in range(2):
        triangles = flip_to_delaunay(plane, triangles)
        plane = smooth(plane, np.array(triangles), movable, sweeps=3)
    return plane, np.array(triangles, dtype=np.int64)


def _stations(divisions: int, floor: float) -> Iterator[tuple[float, float]]:
    """Yield the distances from the base of the columns of points, with the height of the profile there.

    `floor` is the height of the notches' bottom.
    """
    if divisions == 0:
        yield from _corners(floor)
        return
    steps = [step / divisions for step in range(1, divisions + 1)]
    rise = [WALL_KNEE * step for step in steps] + [WALL_KNEE + (1.0 - WALL_KNEE) * step for step in steps]
    yield 0.0, SPINE
    for step in steps:
        yield TONGUE * step, SPINE
    start = TONGUE
    for number in range(BLOCKS):
        foot = floor if number else SPINE
        for share in rise:
            yield start + SLANT * share, foot + (HEIGHT - foot) * share
        start += SLANT
        for step in range(1, 2 * divisions + 1):
            yield start + PLATEAU * step / (2 * divisions), HEIGHT
        start += PLATEAU
        if number < BLOCKS - 1:
            for share in [*reversed(rise[:-1]), 0.0]:
                yield start + SLANT * (1.0 - share), floor + (HEIGHT - floor) * share
            start += SLANT
    for share in (*steps, 2.0):  # one chord at the steep end prevents distorted elements there
        angle = 0.25 * math.pi * share
        yield start + TIP_RADIUS * math.sin(angle), SPINE + TIP_RADIUS * math.cos(angle)


def _corners(floor: float) -> Iterator[tuple[float, float]]:
    """Yield the stations where the profile bends, and one on the round tip."""
    yield 0.0, SPINE
    start = TONGUE
    for number in range(BLOCKS):
        yield start, floor if number else SPINE
        yield start + SLANT, HEIGHT
        yield start + SLANT + PLATEAU, HEIGHT
        start += 2.0 * SLANT + PLATEAU
    start -= SLANT  # the last block ends in the round tip
    for angle in (0.25 * math.pi, 0.5 * math.pi):
        yield start + TIP_RADIUS * math.sin(angle), SPINE + TIP_RADIUS * math.cos(angle)


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line: write the finger's meshes into a folder; returns the exit code."""
    meshes = (finger(divisions, f"finger_{level}") for level, divisions in LEVELS.items())
    description = "Write the finger's meshes into a folder."
    return write_mesh_files("softsim_core.robots.finger_mesh", description, meshes, arguments)


if __name__ == "__main__":
    raise SystemExit(main())
