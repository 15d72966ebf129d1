"""An imported scene as a folder: the scene's file with what was left out on top, and its meshes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from softsim_core.errors import MjcfError
from softsim_core.file_writing import write_file
from softsim_core.mesh import TetMesh, write_surface, write_tets
from softsim_core.mjcf.importing import ImportedScene
from softsim_core.scene.generated import comment
from softsim_core.scene.portable import write_description
from softsim_core.scene.robot import as_robot
from softsim_core.values import MeshFile


def write_imported(imported: ImportedScene, folder: str | Path, origin: str) -> Path:
    """Write a scene and its meshes.

    Args:
        imported: The scene.
        folder: Where to; it is made, and files of these names in it are replaced.
        origin: Name of the model that it was made of, for the scene's first line.

    Returns:
        The scene's file.

    Raises:
        MjcfError, MeshError: a file cannot be written.
    """
    folder = Path(folder)
    scene = imported.scene
    try:
        folder.mkdir(parents=True, exist_ok=True)
        bodies = []
        for body in scene.bodies:
            assert isinstance(body.mesh, TetMesh)  # as all that are imported
            file = Path(f"{body.name}.msh")
            write_tets(folder / file, body.mesh)
            bodies.append(replace(body, mesh=MeshFile(file=file)))
        for name, surface in imported.surfaces.items():
            write_surface(folder / name, surface)
        written = folder / f"{scene.name}.yaml"
        robot = as_robot(replace(scene, bodies=tuple(bodies)))
        text = write_description(robot, given_only=True)
        write_file(written, _head(imported, origin) + text)
    except OSError as error:
        raise MjcfError(folder, f"cannot be written: {error.strerror or error}") from error
    return written


def _head(imported: ImportedScene, origin: str) -> str:
    lines = [f"{imported.scene.name}: made of {origin} (MuJoCo). SI units (m, kg, s, Pa)."]
    if imported.told:
        lines += ["Not taken over, or otherwise than there:", *(f"  {told}" for told in imported.told)]
    return comment(*lines)
