"""Mesh of the Tripod's silicone piece from its dimensions: a flat Y with a round hole, exactly symmetric.

Half an arm (a sector of 60 degrees) is triangulated. Its mirror image and two rotations by 120 degrees make
the whole, which is swept along z. The prisms are divided by labels of the sector's points, so that the
connectivity is symmetric, too.

`python -m softsim_core.robots.tripod_mesh --out configs/meshes` writes the files that the Tripod's config
names.
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from softsim_core.base import MILLIMETRE, Array, IndexArray, MeshError
from softsim_core.physics.mesh import (
    TetMesh,
    boundary_surface,
    extrude,
    flip_to_delaunay,
    smooth,
    stitch,
    write_surface,
    write_tets,
)

ARM_HALF_WIDTH = 15.0 * MILLIMETRE
"""Half the width of an arm in [m]."""
ARM_REACH = 55.0 * MILLIMETRE
"""Distance from the centre to the end of an arm in [m]."""
THICKNESS = 5.0 * MILLIMETRE
"""Thickness in [m]; the piece lies from z = 0 to z = THICKNESS."""
HOLE_RADIUS = 5.0 * MILLIMETRE
"""Radius of the hole in the centre in [m]."""
NARROWEST, WIDEST = 0.009, 0.020
"""Range of half an arm's width in [m] in which arms meet outside the hole, and still are arms."""
TIP_LINE = 45.01 * MILLIMETRE
"""Distance in [m] of a straight row of nodes across each arm.

The tip regions of the robot begin at 45 mm. A row 0.01 mm inside makes the clamped length the same on every
level, independent of round-off.
"""

LEVELS: dict[str, tuple[int, int]] = {"coarse": (1, 1), "low": (2, 1), "mid": (3, 2), "high": (4, 3)}
"""Divisions of half an arm's width and layers through the thickness, by level name.

"coarse" is for quadratic elements (`order: 2`); linear ones of that size hardly bend.
"""

_STRETCH = 1.1
"""Element length along the arm per distance of the lines; 2 / sqrt(3) makes equal-sided triangles."""
_COARSE_STRETCH = 0.5  # with one division: the arm bends along its length
_GRADING = 0.7  # growth of the element size per distance from the hole


def tripod_silicone(
    divisions: int = 2,
    layers: int = 1,
    name: str = "tripod silicone",
    half_width: float = ARM_HALF_WIDTH,
    thickness: float = THICKNESS,
) -> TetMesh:
    """Mesh the silicone Y in its own frame: hole centre at the origin, z up, arm i at 180 + 120 i degrees.

    It is symmetric under rotations by 120 degrees about z and reflection in the plane of each arm, in nodes
    (to round-off) and in connectivity (exactly).

    Args:
        divisions: Elements across half an arm, >= 1; 6 times as many around the hole.
        layers: Elements through the thickness, >= 1.
        name: Name of the mesh.
        half_width: Half the width of an arm in [m], between 9 and 20 mm.
        thickness: In [m], > 0.

    Returns:
        Positively oriented tetrahedra in [m].

    Raises:
        MeshError: divisions or layers is too small, or a length is out of its range.
    """
    if divisions < 1 or layers < 1:
        raise MeshError(name, f"divisions = {divisions} and layers = {layers} must be >= 1")
    if not NARROWEST <= half_width <= WIDEST or not 0.0 < thickness < math.inf:
        width = f"half_width = {half_width:g} m must be between {NARROWEST:g} and {WIDEST:g} m"
        raise MeshError(name, f"{width}, thickness = {thickness:g} m greater than 0")
    half_points, half_triangles = half_arm(divisions, half_width)
    points, triangles, labels = _replicate(half_points, half_triangles)
    heights = thickness * np.arange(layers + 1) / layers
    solid, tets = extrude(points, triangles, labels, heights)
    return TetMesh(solid, tets, name)


def half_arm(divisions: int, half_width: float = ARM_HALF_WIDTH) -> tuple[Array, IndexArray]:
    """Triangulate half of an arm along +x: polar angle up to 60 degrees, outside the hole.

    Args:
        divisions: Elements across it.
        half_width: Its half width along y in [m].

    Returns:
        Points in [m], shape (n, 2), and counter-clockwise triangles, shape (k, 3).
    """
    points: list[tuple[float, float]] = []
    lines: list[list[int]] = []
    for line in range(divisions + 1):
        new = _line_points(line, divisions, half_width)
        lines.append(list(range(len(points), len(points) + len(new))))
        points.extend(new)
    plane = np.array(points)
    triangles = [
        triangle for right, left in itertools.pairwise(lines) for triangle in stitch(plane, left, right)
    ]
    movable = _motions(plane, lines, half_width)
    for _ in range(3):
        triangles = flip_to_delaunay(plane, triangles)
        plane = smooth(plane, np.array(triangles), movable, sweeps=10)
    return plane, np.array(triangles, dtype=np.int64)


def _root(half_width: float) -> float:
    """Return the distance along an arm's axis in [m] at which the sides of neighbouring arms meet."""
    return half_width / math.sqrt(3.0)


def _line_points(line: int, divisions: int, half_width: float) -> list[tuple[float, float]]:
    """Return the points of one line from the hole to the arm's end; odd lines are half an element off."""
    angle, y = math.pi / 3.0 * line / divisions, half_width * line / divisions
    root = _root(half_width)
    start = (HOLE_RADIUS * math.cos(angle), HOLE_RADIUS * math.sin(angle))
    hub = math.dist(start, (root, y))
    length = hub + TIP_LINE - root
    stretch = _COARSE_STRETCH if divisions == 1 else _STRETCH
    size, size_at_hole = stretch * half_width / divisions, HOLE_RADIUS * math.pi / 3.0 / divisions
    growing = min(length, (size - size_at_hole) / _GRADING)  # where the size grows from hole to arm

    def elements(distance: float) -> float:
        """Return the number of elements from the hole to this distance: the integral of 1 / size."""
        within = math.log1p(_GRADING * min(distance, growing) / size_at_hole) / _GRADING
        return within + max(0.0, distance - growing) / size

    def distance(count: float) -> float:
        within = elements(growing)
        if count > within:
            return growing + (count - within) * size
        return size_at_hole * math.expm1(_GRADING * count) / _GRADING

    # Counted from the tip line inwards, so that neighbouring lines stay half an element apart along the arm.
    total, half = elements(length), 0.5 * (line % 2)
    last = max(1, round(total - half)) + half
    steps = [last - step for step in range(int(last) + 1)]
    along = [distance(total * step / last) for step in sorted({0.0, *steps, last})]
    points = []
    for travelled in along:
        if travelled < hub:
            part = travelled / hub
            points.append((start[0] + part * (root - start[0]), start[1] + part * (y - start[1])))
        else:
            points.append((root + travelled - hub, y))
    points[-1] = (TIP_LINE, y)
    if line == divisions:  # the inner corner belongs to the outline
        points[min(range(len(points)), key=lambda index: math.dist(points[index], (root, y)))] = (root, y)
    tip = max(1, round((ARM_REACH - TIP_LINE) / size))
    stops = range(1, tip) if line % 2 == 0 else [index + 0.5 for index in range(tip)]
    points.extend((TIP_LINE + (ARM_REACH - TIP_LINE) * stop / tip, y) for stop in stops)
    return [*points, (ARM_REACH, y)]


def _motions(points: Array, lines: Sequence[Sequence[int]], half_width: float) -> Array:
    """Return the allowed motion of each point in smoothing: in the plane, along its border, or none."""
    root = _root(half_width)
    movable = np.tile(np.eye(2), (len(points), 1, 1))
    x_only, y_only = np.diag([1.0, 0.0]), np.diag([0.0, 1.0])
    diagonal = np.array([0.5, math.sqrt(0.75)])
    for index in lines[0]:
        movable[index] = x_only
    for index in lines[-1]:
        movable[index] = x_only if points[index, 0] > root else np.outer(diagonal, diagonal)
    for line in lines:
        for index in line:
            if points[index, 0] in (TIP_LINE, ARM_REACH):
                movable[index] = 0.0 if line in (lines[0], lines[-1]) else y_only
        movable[line[0]] = 0.0
    movable[(points == [root, half_width]).all(axis=1)] = 0.0
    return movable


def _replicate(points: Array, triangles: IndexArray) -> tuple[Array, IndexArray, IndexArray]:
    """Return the whole Y from half an arm along +x, mirrored in y and rotated to 180, 300, 60 degrees.

    Returns:
        Points, shape (n, 2); counter-clockwise triangles; the index of each point's original, shape (n,).
    """
    images, faces = [], []
    sine = math.sqrt(0.75)
    for cosine, turn in ((-1.0, 0.0), (0.5, -sine), (0.5, sine)):
        rotation = np.array([[cosine, -turn], [turn, cosine]])
        for mirror in (1.0, -1.0):
            images.append(points @ (rotation * [1.0, mirror]).T)
            faces.append(triangles if mirror > 0.0 else triangles[:, ::-1])
    copies = np.concatenate(images)
    _, first, inverse = np.unique(np.round(copies / 1.0e-9), axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)  # order of first appearance
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    merged = rank[inverse.reshape(-1)]
    shifts = len(points) * np.arange(len(images))
    all_faces = np.concatenate([face + shift for face, shift in zip(faces, shifts, strict=True)])
    return copies[first[order]], merged[all_faces], first[order] % len(points)


def write_mesh_files(
    module: str, description: str, meshes: Iterable[TetMesh], arguments: Sequence[str] | None = None
) -> int:
    """Write NAME.vtk (tetrahedra) and NAME.stl (boundary) of each mesh, in metres, into the folder `--out`.

    Args:
        module: Name of the module that is run.
        description: One line for the help.
        meshes: The meshes, each written under its name.
        arguments: Command line without the program's name; None: that of the process.

    Returns:
        Exit code; a mesh that cannot be made or written ends the process with 1 and a message.
    """
    parser = argparse.ArgumentParser(prog=f"python -m {module}", description=description)
    parser.add_argument("-o", "--out", type=Path, default=Path("configs/meshes"), help="folder to write into")
    folder: Path = parser.parse_args(arguments).out
    try:
        for mesh in meshes:
            write_tets(folder / f"{mesh.name}.vtk", mesh)
            write_surface(folder / f"{mesh.name}.stl", boundary_surface(mesh))
    except MeshError as error:
        parser.exit(1, f"{error}\n")
    return 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line: write the Tripod's meshes into a folder; returns the exit code."""
    meshes = (tripod_silicone(*size, f"tripod_{level}") for level, size in LEVELS.items())
    description = "Write the Tripod's meshes into a folder."
    return write_mesh_files("softsim_core.robots.tripod_mesh", description, meshes, arguments)


if __name__ == "__main__":
    raise SystemExit(main())
