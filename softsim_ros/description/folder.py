"""Write a folder with all files about a robot for other programs, including ros2_control's parameters."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import yaml

from softsim_core import RobotDescription
from softsim_core.base import MeshFile, make_folder, write_file
from softsim_core.physics.mesh import write_surface
from softsim_core.simulation import SceneState
from softsim_node import prefix_of
from softsim_ros.description.layouts import foxglove_layout, rviz_config
from softsim_ros.description.urdf_model import control_topics, urdf

CONTROLLER: Final = "joint_trajectory_controller"
UPDATE_RATE: Final = 100
"""Update rate of the controller manager in [Hz]."""

GOAL_TOLERANCE: Final = 0.02
"""Largest final distance of a joint from its goal, in [rad] or [m]; the silicone pulls on it."""

GOAL_TIME: Final = 0.0
"""How long after the end of a trajectory its joints may take to arrive, in [s]; 0: as long as it takes."""


def controllers(robot: RobotDescription, namespace: str) -> str:
    """Return YAML text with one trajectory controller for all joints, in the namespace of the robot."""
    start = f"/{namespace.strip('/')}".rstrip("/")
    kind = "joint_trajectory_controller/JointTrajectoryController"
    constraints: dict[str, Any] = {"stopped_velocity_tolerance": 0.0, "goal_time": GOAL_TIME}
    constraints |= {joint: {"goal": GOAL_TOLERANCE} for joint in robot.joint_names}
    controller = {
        "type": kind,
        "joints": list(robot.joint_names),
        "command_interfaces": ["position"],
        "state_interfaces": ["position"],
        "allow_partial_joints_goal": True,
        "constraints": constraints,
    }
    manager = {"update_rate": UPDATE_RATE, CONTROLLER: {"type": kind}}
    nodes = {"controller_manager": manager, CONTROLLER: controller}
    return yaml.safe_dump(
        {f"{start}/{name}": {"ros__parameters": values} for name, values in nodes.items()}, sort_keys=False
    )


def companions(robot: RobotDescription, namespace: str) -> dict[str, str]:
    """Return names and texts of the files beside a robot's URDF."""
    prefix = prefix_of(namespace)
    return {
        f"{robot.name}_controllers.yaml": controllers(robot, namespace),
        f"{robot.name}.rviz": rviz_config(robot, prefix),
        f"{robot.name}_foxglove.json": foxglove_layout(robot, namespace, prefix),
    }


def write_folder(robot: RobotDescription, folder: Path, namespace: str) -> list[Path]:
    """Write `NAME.urdf`, its meshes as STL files in `meshes/`, and the files beside it.

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
