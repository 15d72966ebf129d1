"""Mesh of a measured tentacle: a tapered round bar of silicone.

It hangs from its base at the origin along -z. The sections of a bar of quadratic cells, two by two across,
are made round. Some sections lie at the positions of measured markers.

`python -m softsim_core.robots.tentacle_mesh --out configs/meshes` writes the files that the scene names.

Source of the dimensions: SoRoMoX, the tentacle of its system identification.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from softsim_core.physics.mesh import TetMesh, box_mesh, quadratic
from softsim_core.robots.tripod_mesh import write_mesh_files

LENGTH, TAPER = 0.36, 0.305
"""Length of the bar, and distances from the base at which tendons and the steep taper end, in [m]."""

RADII = (0.01541, 0.00642, 0.0048)
"""Radii at the base, at the end of the taper and at the tip, in [m]."""

SECTIONS = np.concatenate([
    np.linspace(0.0, 0.1291, 6), np.linspace(0.1291, 0.2195, 5)[1:], np.linspace(0.2195, 0.28, 4)[1:],
    [0.2925, TAPER, 0.32, 0.34, LENGTH],
])  # fmt: skip
"""Distances in [m] from the base of sections between cells; markers were at three of them, and the tip."""


def tentacle(name: str = "tentacle") -> TetMesh:
    """Return a mesh of 875 nodes in [m] with quadratic cells; mid-edge nodes lie on the sections' circles.

    Args:
        name: Name of the mesh.
    """
    cells = len(SECTIONS) - 1
    bar = quadratic(box_mesh((cells, 2.0, 2.0), (cells, 2, 2), (0.0, -1.0, -1.0)))
    number, u, v = bar.points.T
    along = np.interp(number, np.arange(cells + 1), SECTIONS)
    radius = np.interp(along, [0.0, TAPER, LENGTH], RADII)
    y, x = u * np.sqrt(1.0 - 0.5 * v**2), v * np.sqrt(1.0 - 0.5 * u**2)
    return TetMesh(np.stack([x * radius, y * radius, -along], axis=1), bar.tets, name)


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the mesh."""
    description = "Write the mesh of the tentacle."
    return write_mesh_files("softsim_core.robots.tentacle_mesh", description, [tentacle()], arguments)


if __name__ == "__main__":
    raise SystemExit(main())
