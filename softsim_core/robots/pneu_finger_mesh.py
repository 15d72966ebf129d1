"""Mesh of the pneumatic finger: a bar of silicone with a row of chambers, closed by thin walls (a PneuNet).

Its section is a frame of four trapezoids around a rectangle, swept along the finger; the rectangle is filled
in the walls between the chambers and at both ends, and left out in the chambers. In its own frame the finger
extends along x from its base at x = 0, and the side with the paper lies at z = 0. The dimensions are our own,
similar to PneuNets that laboratories cast (Ilievski et al. 2011, Soft robotics for chemists).

`python -m softsim_core.robots.pneu_finger_mesh --out configs/meshes` writes the files that the robot's config
names.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from softsim_core.base import MILLIMETRE, MeshError
from softsim_core.physics.mesh import TetMesh, extrude, orient_tets
from softsim_core.robots.tripod_mesh import write_mesh_files

WIDTH = 14.0 * MILLIMETRE
"""Width in [m]; the finger lies from y = -WIDTH / 2 to WIDTH / 2."""
HEIGHT = 12.0 * MILLIMETRE
"""Height in [m]."""
SIDE = 2.5 * MILLIMETRE
"""Thickness in [m] of the floor, the roof and the two sides."""
CHAMBER = 8.0 * MILLIMETRE
"""Length in [m] of a chamber along the finger."""
WALL = 2.0 * MILLIMETRE
"""Thickness in [m] of the walls between chambers."""
END = 4.0 * MILLIMETRE
"""Thickness in [m] of both ends."""
CHAMBERS = 6
"""Number of chambers of the robot's finger."""


def length_of(chambers: int) -> float:
    """Return the length in [m] of a finger with a number of chambers."""
    return 2.0 * END + chambers * CHAMBER + (chambers - 1) * WALL


def pneu_finger(chambers: int = CHAMBERS, name: str = "pneu_finger") -> TetMesh:
    """Mesh the finger in its own frame.

    Args:
        chambers: Number of chambers, >= 1.
        name: Name of the mesh.

    Returns:
        Positively oriented tetrahedra in [m], which enclose one cavity per chamber.

    Raises:
        MeshError: the number of chambers is less than 1.
    """
    if chambers < 1:
        raise MeshError(name, f"a finger has at least one chamber, not {chambers}")
    outside = np.array([[-0.5, 0.0], [0.5, 0.0], [0.5, 1.0], [-0.5, 1.0]]) * [WIDTH, HEIGHT]
    middle = np.array([0.0, 0.5 * HEIGHT])
    inside = middle + (outside - middle) * (1.0 - 2.0 * SIDE / np.array([WIDTH, HEIGHT]))
    frame = []
    for a in range(4):
        b = (a + 1) % 4
        frame += [[a, b, 4 + b], [a, 4 + b, 4 + a]] if a % 2 == 0 else [[a, b, 4 + a], [b, 4 + b, 4 + a]]
    triangles = np.array([*frame, [4, 5, 6], [4, 6, 7]])
    lengths = [END, *[CHAMBER, WALL] * (chambers - 1), CHAMBER, END]
    places = np.concatenate([[0.0], np.cumsum(lengths)])
    points, tets = extrude(np.concatenate([outside, inside]), triangles, np.arange(8), places)
    layer = np.repeat(np.arange(len(lengths)), 3 * len(triangles))
    filling = np.tile(np.arange(len(triangles)) >= len(frame), 3 * len(lengths))
    points = points[:, [2, 0, 1]]
    return TetMesh(points, orient_tets(points, tets[~(filling & (layer % 2 == 1))]), name)


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line: write the finger's mesh into a folder; returns the exit code."""
    description = "Write the pneumatic finger's mesh into a folder."
    return write_mesh_files("softsim_core.robots.pneu_finger_mesh", description, [pneu_finger()], arguments)


if __name__ == "__main__":
    raise SystemExit(main())
