"""Everything about a robot that other programs read, as files in one folder."""

from __future__ import annotations

from pathlib import Path

from softsim_core import RobotDescription
from softsim_core.file_writing import make_folder, write_file
from softsim_core.mesh.writers import write_surface
from softsim_core.simulation.scene_state import SceneState
from softsim_core.values import MeshFile
from softsim_node.frames import prefix_of
from softsim_ros.description.controllers import controllers
from softsim_ros.description.foxglove import foxglove_layout
from softsim_ros.description.rviz import rviz_config
from softsim_ros.description.urdf import control_topics, urdf


def companions(robot: RobotDescription, namespace: str) -> dict[str, str]:
    """Names and texts of the files beside a robot's URDF."""
    prefix = prefix_of(namespace)
    return {
        f"{robot.name}_controllers.yaml": controllers(robot, namespace),
        f"{robot.name}.rviz": rviz_config(robot, prefix),
        f"{robot.name}_foxglove.json": foxglove_layout(robot, namespace, prefix),
    }


def write_folder(robot: RobotDescription, folder: Path, namespace: str) -> list[Path]:
    """Write `NAME.urdf`, its meshes as STL files in `meshes/`, and what stands beside it.

    Returns:
        The files, the URDF first.

    Raises:
        MeshError: a mesh cannot be read or written.
        OSError: another file cannot be written.
    """
    built = SceneState(robot.scene, "scipy")
    surfaces = {f"bodies/{body.name}": body.surface for body in built.bodies}
    surfaces |= {f"rigid_bodies/{body.name}": body.surface for body in built.rigid_bodies}
    meshes: list[Path] = []

    def write(part: str, mesh: MeshFile | None) -> tuple[str, None]:
        file = make_folder(folder.absolute() / "meshes") / f"{part.replace('/', '_')}.stl"
        meshes.append(write_surface(file, surfaces[part]))
        return file.as_uri(), None

    text = urdf(robot, topics=control_topics(namespace), meshes=write)
    texts = {f"{robot.name}.urdf": text, **companions(robot, namespace)}
    folder.mkdir(parents=True, exist_ok=True)
    for name, each in texts.items():
        write_file(folder / name, each)
    return [*(folder / name for name in texts), *meshes]
