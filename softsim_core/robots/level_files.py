"""Files of a generated mesh at all its levels, and the command line that writes them."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path

from softsim_core.base import MeshError
from softsim_core.physics.mesh import TetMesh, boundary_surface, write_surface, write_tets


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
