"""Estimate of a scene's memory from its description, and the limit for scenes from messages.

A message of two hundred bytes can describe a body of any size. Anything built because of a message is
measured here first, before it is drawn, meshed or factorised.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from typing import Final

from softsim_core.base import SceneError
from softsim_core.physics.fem.elements import element
from softsim_core.physics.mesh import TetMesh, read_tets
from softsim_core.scene.deformable import BodyDescription
from softsim_core.scene.description import SceneDescription

VARIABLE: Final = "SOFTSIM_MOST_MEMORY"
MOST_GIGABYTES: Final = 2.0
"""Default memory limit of a scene, if the environment variable is not set."""

_NODE_BYTES, _CELL_BYTES, _FACTOR_BYTES = 1000.0, 4000.0, 156.0
"""Bytes per node, cell, and unknown to the power of 4/3 (8232 unknowns: 2.1 million numbers)."""

_SMALL_FILE = 40_000
"""A file of fewer bytes is not measured: it contains some thousand nodes at most."""


@dataclass(frozen=True, slots=True)
class SceneSize:
    """Size of the deformable bodies of a scene.

    Attributes:
        nodes, cells: Total numbers.
        largest: Name of the body with the most nodes; empty without bodies.
    """

    nodes: int
    cells: int
    largest: str

    @property
    def gigabytes(self) -> float:
        """Approximate memory of state, matrices and their factor, in [GB]."""
        factor = _FACTOR_BYTES * math.pow(3.0 * self.nodes, 4.0 / 3.0)
        return (_NODE_BYTES * self.nodes + _CELL_BYTES * self.cells + factor) / 1e9


def scene_size(scene: SceneDescription, *, read_files: bool = True) -> SceneSize:
    """Measure a scene without building it.

    Raises:
        MeshError: a file of a mesh cannot be read; without `read_files`, such meshes do not count.
    """
    sizes = {body.name: _body_size(body, read_files) for body in scene.bodies}
    largest = max(sizes, key=lambda name: sizes[name][0], default="")
    return SceneSize(
        sum(nodes for nodes, _ in sizes.values()), sum(cells for _, cells in sizes.values()), largest
    )


def check_size(scene: SceneDescription, *, read_files: bool = True) -> None:
    """Reject a scene that needs more memory than allowed for messages; call it before anything is built.

    Args:
        scene: The scene.
        read_files: Whether meshes in files count; False where a message may have named the files.

    Raises:
        SceneError: it needs more, or the environment variable is no number.
        MeshError: a file of a mesh cannot be read.
    """
    size, most = scene_size(scene, read_files=read_files), _most_gigabytes()
    if size.gigabytes > most:
        raise SceneError(
            f"scene {scene.name} needs about {size.gigabytes:.3g} GB ({size.nodes} nodes and"
            f" {size.cells} cells, most of them in body {size.largest}), and {most:g} GB are allowed; give it"
            f" fewer, or start with {VARIABLE}={math.ceil(size.gigabytes)} in the environment"
        )


def _most_gigabytes() -> float:
    text = os.environ.get(VARIABLE, "")
    try:
        most = float(text) if text else MOST_GIGABYTES
    except ValueError:
        most = math.nan
    if not most > 0.0:
        raise SceneError(f"{VARIABLE}={text[:40]!r} in the environment is refused; give a number > 0, in GB")
    return most


def _body_size(body: BodyDescription, read_files: bool) -> tuple[int, int]:
    """Return nodes and cells of a body; zero for a file that is too small to matter, or not to be read."""
    rod, mesh = body.rod, body.mesh
    if rod is not None and body.is_rod:  # three nodes per section, two sections per cell and clamp, plus one
        cells = rod.elements + (rod.start_clamp is not None) + (rod.end_clamp is not None)
        return 3 * (2 * cells + 1), cells
    if rod is not None:  # boxes of six tetrahedra; ten-node elements also have nodes on their edges
        first, second = rod.across
        parts = 1 if len(element(body.element or "").reference) == 4 else 2
        nodes = (parts * rod.elements + 1) * (parts * first + 1) * (parts * second + 1)
        return nodes, 6 * rod.elements * first * second
    if mesh is None:
        return 0, 0
    if not isinstance(mesh, TetMesh):
        if not (read_files and mesh.file.is_file() and mesh.file.stat().st_size >= _SMALL_FILE):
            return 0, 0
        mesh = read_tets(mesh.file)
    corners = mesh.tets.shape[1]
    grown = 8 if body.order == 2 and corners == 4 else 1
    return grown * len(mesh.points), len(mesh.tets)
