"""Mesh of the pneumatic arm: a round silicone bar with chambers around its axis that bend it to any side.

Its section consists of rings of nodes: a solid core or a bore, an inner tube, the chambers between ribs of
constant thickness, and an outer wall. It is swept along the arm, with a cap at both ends of the chambers. The
cells are quadratic, and the nodes in the middle of edges lie on the circles. In its own frame, the arm runs
along z from its base at z = 0, and the first chamber lies at +x.

`python -m softsim_core.robots.pneu_arm_mesh --out configs/meshes` writes the files that the configs of both
robots name: `pneu_arm`, a design, and `pneumatic_arm`, which was measured.

Source of the measured dimensions: Dubied, Michelis, Spielberg, Katzschmann, RA-L 7(2) 2022.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from softsim_core.base import MILLIMETRE, Array, BoolArray, IndexArray, MeshError
from softsim_core.physics.mesh import MIDDLES, TetMesh, extrude, orient_tets, quadratic
from softsim_core.robots.tripod_mesh import write_mesh_files


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmShape:
    """Dimensions of an arm, lengths in [m].

    Attributes:
        chambers: Number of chambers around the axis, 2 to 6.
        length: Length of the whole arm.
        radius: Outer radius.
        wall: Thickness of the outer wall.
        tube: Outer radius of the inner tube, where the chambers begin.
        bore: Radius of a hole along the axis; 0: the core is solid.
        rib: Thickness of the ribs between chambers.
        base_cap: Thickness of the cap at the base.
        tip_cap: Thickness of the cap at the tip.
        across: Cells around each chamber.
        along: Cells along the chambers.
    """

    chambers: int = 3
    length: float = 70.0 * MILLIMETRE
    radius: float = 16.0 * MILLIMETRE
    wall: float = 3.0 * MILLIMETRE
    tube: float = 5.0 * MILLIMETRE
    bore: float = 0.0
    rib: float = 4.0 * MILLIMETRE
    base_cap: float = 8.0 * MILLIMETRE
    tip_cap: float = 8.0 * MILLIMETRE
    across: int = 2
    along: int = 4

    def __post_init__(self) -> None:
        if not 2 <= self.chambers <= 6 or self.across < 1 or self.along < 1:
            raise MeshError("pneu_arm", "chambers must be 2 to 6, across and along at least 1")
        rings = [self.bore, self.tube, self.radius - self.wall, self.radius]
        lengths = (self.rib, self.base_cap, self.tip_cap, self.length - self.base_cap - self.tip_cap)
        if self.bore < 0.0 or np.min(np.diff(rings)) <= 0.0 or min(lengths) <= 0.0:
            problem = "from inside out: 0 <= bore < tube < radius - wall < radius; the rest > 0"
            raise MeshError("pneu_arm", problem)
        if self.rib >= 2.0 * self.tube * np.sin(np.pi / self.chambers):
            raise MeshError("pneu_arm", "the ribs leave no room for chambers; make rib or the number smaller")


MEASURED = ArmShape(
    chambers=4, length=0.102, radius=0.0222, wall=0.00203, tube=0.01063, bore=0.00807, rib=0.00227,
    base_cap=0.002, tip_cap=0.00693, across=2, along=4,
)  # fmt: skip
"""The measured arm. Its inner tube is square; this one is round, of the same areas. Its ribs are not known.
The cap at the base is the part in the clamp, where the real chambers end."""


def pneu_arm(shape: ArmShape | None = None, name: str = "pneu_arm") -> TetMesh:
    """Mesh the arm in its own frame, symmetric under rotation by one chamber.

    Args:
        shape: Its dimensions; None: those of the robot.
        name: Name of the mesh.

    Returns:
        Positively oriented quadratic tetrahedra in [m], which enclose one cavity per chamber.
    """
    shape = shape or ArmShape()
    points, triangles, labels, is_chamber, rings = _section(shape)
    inner = np.linspace(shape.base_cap, shape.length - shape.tip_cap, shape.along + 1)
    heights = np.concatenate([[0.0], inner, [shape.length]])
    solid, tets = extrude(points, triangles, labels, heights)
    layers = len(heights) - 1
    layer = np.repeat(np.arange(layers), 3 * len(triangles))
    hollow = np.tile(is_chamber, 3 * layers) & (layer > 0) & (layer < layers - 1)
    mesh = quadratic(TetMesh(solid, orient_tets(solid, tets[~hollow]), name))
    return replace(mesh, points=_round_edges(mesh, np.tile(rings, layers + 1)))


def _section(shape: ArmShape) -> tuple[Array, IndexArray, IndexArray, BoolArray, IndexArray]:
    """Return the section: points (n, 2), triangles (k, 3), labels (n,), chamber flags (k,), rings (n,)."""
    radii = [shape.bore, shape.tube, shape.radius - shape.wall, shape.radius]
    radii = radii if shape.bore > 0.0 else radii[1:]
    per_sector = shape.across + 1
    count = shape.chambers * per_sector
    points, labels, rings = [], [], []
    for ring, radius in enumerate(radii):
        half_rib = np.arcsin(min(0.5 * shape.rib / max(radius, shape.tube), 1.0))
        half = np.pi / shape.chambers - half_rib
        for sector in range(shape.chambers):
            middle = 2.0 * np.pi * sector / shape.chambers
            angles = middle + np.linspace(-half, half, per_sector)
            points += [[radius * np.cos(angle), radius * np.sin(angle)] for angle in angles]
        labels += [ring * per_sector + k % per_sector for k in range(count)]
        rings += [ring] * count
    triangles, is_chamber = [], []
    chamber_ring = len(radii) - 3
    for ring in range(len(radii) - 1):
        for k in range(count):
            a, b = ring * count + k, ring * count + (k + 1) % count
            triangles += [[a, b, b + count], [a, b + count, a + count]]
            is_chamber += [ring == chamber_ring and k % per_sector != per_sector - 1] * 2
    if shape.bore == 0.0:
        middle_point = len(points)
        triangles += [[middle_point, k, (k + 1) % count] for k in range(count)]
        is_chamber += [False] * count
        points, labels, rings = [*points, [0.0, 0.0]], [*labels, len(radii) * per_sector], [*rings, -1]
    return np.array(points), np.array(triangles), np.array(labels), np.array(is_chamber), np.array(rings)


def _round_edges(mesh: TetMesh, rings: IndexArray) -> Array:
    """Return the points of a quadratic mesh, with mid-edge nodes around the axis on interpolated circles."""
    points = mesh.points.copy()
    ends, middles = mesh.tets[:, MIDDLES].reshape(-1, 2), mesh.tets[:, 4:].ravel()
    is_around = (rings[ends] >= 0).all(axis=1)
    ends, middles = ends[is_around], middles[is_around]
    radius = np.linalg.norm(points[ends, :2], axis=2).mean(axis=1)
    straight = points[middles, :2]
    points[middles, :2] = straight * (radius / np.linalg.norm(straight, axis=1))[:, None]
    return points


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line: write the arm's mesh into a folder; returns the exit code."""
    description = "Write the pneumatic arms' meshes into a folder."
    meshes = [pneu_arm(), pneu_arm(MEASURED, "pneumatic_arm")]
    return write_mesh_files("softsim_core.robots.pneu_arm_mesh", description, meshes, arguments)


if __name__ == "__main__":
    raise SystemExit(main())
