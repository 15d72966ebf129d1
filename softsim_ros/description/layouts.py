"""Files for other programs: layouts for RViz and Foxglove, parameters of ros2_control.

Topics are relative: RViz runs in the robot's namespace.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import yaml

from softsim_core import RobotDescription
from softsim_core.base import MeshFile, make_folder, write_file
from softsim_core.physics.mesh import write_surface
from softsim_core.simulation import SceneState
from softsim_node import WORLD, prefix_of
from softsim_ros import chambers_of
from softsim_ros.description.links import links_of
from softsim_ros.description.urdf_model import control_topics, urdf

CONTROLLER: Final = "joint_trajectory_controller"
UPDATE_RATE: Final = 100
"""Update rate of the controller manager in [Hz]."""

GOAL_TOLERANCE: Final = 0.02
"""Largest final distance of a joint from its goal, in [rad] or [m]; the silicone pulls on it."""

GOAL_TIME: Final = 0.0
"""How long after the end of a trajectory its joints may take to arrive, in [s]; 0: as long as it takes."""


class LayoutTopic(NamedTuple):
    """A topic in a layout.

    Attributes:
        topic: Its name in the robot's namespace.
        type_name: Its type, such as "visualization_msgs/msg/Marker".
        kind: RViz's display for it.
        name: Title of the display.
        enabled: Whether it is shown from the start.
        latched: Whether it is sent once, also to late joiners.
        options: More settings of the display.
    """

    topic: str
    type_name: str
    kind: str
    name: str
    enabled: bool = True
    latched: bool = False
    options: dict[str, Any] = {}  # noqa: RUF012  (a NamedTuple's default; never changed)


_AXES: Final = {"Shape": "Axes", "Axes Length": 0.02, "Axes Radius": 0.001}
_MARKERS: Final = "visualization_msgs/msg/MarkerArray"
_POSE: Final = "geometry_msgs/msg/PoseStamped"
_CLOUD: Final = {
    "Channel Name": "von_mises", "Color Transformer": "Intensity", "Size (Pixels)": 3, "Style": "Points",
}  # fmt: skip

SHOWN: Final = (
    LayoutTopic("mesh/marker", "visualization_msgs/msg/Marker", "Marker", "Silicone"),
    LayoutTopic(
        "mesh/points", "sensor_msgs/msg/PointCloud2", "PointCloud2", "Stress", enabled=False, options=_CLOUD
    ),
    LayoutTopic("cables", _MARKERS, "MarkerArray", "Cables"),
    LayoutTopic("chambers", _MARKERS, "MarkerArray", "Pressure chambers"),
    LayoutTopic("bodies/topology", _MARKERS, "MarkerArray", "Rigid bodies", latched=True),
    LayoutTopic("contacts", _MARKERS, "MarkerArray", "Contacts"),
    LayoutTopic("collisions", _MARKERS, "MarkerArray", "Collision surfaces", enabled=False),
    LayoutTopic("effector_pose", _POSE, "Pose", "Effector", options=_AXES),
    LayoutTopic("effector_goal", _POSE, "Pose", "Goal", options={"Color": "255; 25; 0", **_AXES}),
)


def rviz_config(robot: RobotDescription, frame_prefix: str) -> str:
    """Return the text of an .rviz file; `frame_prefix` is the prefix of the frames, such as "left/"."""
    at_rest = [link.name for link in links_of(robot) if link.part.startswith("bodies/")]
    displays = [
        {"Class": "rviz_default_plugins/Grid", "Name": "Grid", "Enabled": True, "Cell Size": 0.02},
        {"Class": "rviz_default_plugins/TF", "Name": "Frames", "Enabled": True, "Marker Scale": 0.08},
        {
            "Class": "rviz_default_plugins/RobotModel",
            "Name": "Robot",
            "Enabled": True,
            "Description Source": "Topic",
            "Description Topic": _topic("robot_description", latched=True),
            "TF Prefix": frame_prefix.rstrip("/"),
            "Links": {name: {"Value": False} for name in at_rest},  # the moving silicone is a marker
        },
        *(
            {
                "Class": f"rviz_default_plugins/{each.kind}",
                "Name": each.name,
                "Enabled": each.enabled,
                "Topic": _topic(each.topic, latched=each.latched),
                **each.options,
            }
            for each in SHOWN
        ),
    ]
    view = {"Class": "rviz_default_plugins/Orbit", "Name": "Current View", "Distance": 0.45}
    view |= {"Focal Point": {"X": 0, "Y": 0, "Z": 0.02}, "Pitch": 0.5, "Yaw": 0.8}
    config = {
        "Panels": [{"Class": "rviz_common/Displays", "Name": "Displays"}],
        "Visualization Manager": {
            "Class": "",
            "Global Options": {"Background Color": "48; 48; 48", "Fixed Frame": WORLD, "Frame Rate": 30},
            "Displays": displays,
            "Tools": [{"Class": f"rviz_default_plugins/{name}"} for name in ("MoveCamera", "FocusCamera")],
            "Transformation": {"Current": {"Class": "rviz_default_plugins/TF"}},
            "Views": {"Current": view},
        },
        "Window Geometry": {"Height": 900, "Width": 1400},
    }
    return yaml.safe_dump(config, sort_keys=False)


def _topic(name: str, *, latched: bool) -> dict[str, Any]:
    return {
        "Value": name,
        "Depth": 1,
        "Durability Policy": "Transient Local" if latched else "Volatile",
        "History Policy": "Keep Last",
        "Reliability Policy": "Reliable",
    }


def foxglove_layout(robot: RobotDescription, namespace: str, frame_prefix: str) -> str:
    """Return the text of a layout file; `namespace` is that of its topics, the rest as for RViz."""
    start = f"/{namespace.strip('/')}/" if namespace.strip("/") else "/"
    joints, chambers = robot.joint_names, chambers_of(robot.joints)
    panels: dict[str, Any] = {
        "3D!robot": {
            "followTf": WORLD,
            "topics": {f"{start}{each.topic}": {"visible": each.enabled} for each in SHOWN},
            "layers": {
                "robot": {
                    "layerId": "foxglove.Urdf",
                    "sourceType": "topic",
                    "topic": f"{start}robot_description",
                    "framePrefix": frame_prefix,
                    "visible": True,
                }
            },
        },
        **{
            f"Plot!{field}": _plot(
                field, joints, [f"{start}joint_states.{field}[{k}]" for k in range(len(joints))]
            )
            for field in ("position", "effort")
        },
        "Publish!command": {
            "topicName": f"{start}position_controller/commands",
            "datatype": "std_msgs/msg/Float64MultiArray",
            "value": json.dumps({"data": list(robot.start_joints)}),
            "buttonText": "start pose",
            "editingMode": False,
        },
        "DiagnosticSummary!nodes": {"topicToRender": "/diagnostics"},
    }
    below = {"direction": "column", "first": "Publish!command", "second": "DiagnosticSummary!nodes"}
    curves: dict[str, Any] = {"direction": "column", "first": "Plot!position", "second": "Plot!effort"}
    if chambers:
        pressures = [f"{start}{topic}.fluid_pressure" for topic in chambers.values()]
        panels["Plot!pressure"] = _plot("pressure", [joints[index] for index in chambers], pressures)
        curves = {"direction": "column", "first": curves, "second": "Plot!pressure", "splitPercentage": 67}
    side = {"direction": "column", "first": curves, "second": below, "splitPercentage": 60}
    layout = {"direction": "row", "first": "3D!robot", "second": side, "splitPercentage": 60}
    rest: dict[str, Any] = {"globalVariables": {}, "userNodes": {}, "playbackConfig": {"speed": 1}}
    return json.dumps({"configById": panels, **rest, "layout": layout}, indent=2) + "\n"


def _plot(title: str, labels: Sequence[str], paths: Sequence[str]) -> dict[str, Any]:
    """Return a panel with a curve for each path of a number in a message."""
    curves = [
        {"value": path, "label": label, "enabled": True} for label, path in zip(labels, paths, strict=True)
    ]
    return {"title": title, "paths": curves, "showLegend": True, "followingViewWidth": 20}


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
