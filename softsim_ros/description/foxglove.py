"""A layout for Foxglove: the robot in 3D, joints, efforts and pressures over time, a panel that commands."""

from __future__ import annotations

import json
from typing import Any

from softsim_core import RobotDescription
from softsim_ros.chamber_topics import chambers_of
from softsim_ros.description.rviz import SHOWN
from softsim_ros.frames import WORLD


def foxglove_layout(robot: RobotDescription, namespace: str, frame_prefix: str) -> str:
    """The text of a layout file.

    Args:
        robot: What is shown.
        namespace: Of its topics.
        frame_prefix: Of its frames, such as "left/".
    """
    start = f"/{namespace.strip('/')}/" if namespace.strip("/") else "/"
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
        "Plot!position": _curves(robot, f"{start}joint_states", "position"),
        "Plot!effort": _curves(robot, f"{start}joint_states", "effort"),
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
    if pressures := _pressures(robot, start):
        panels["Plot!pressure"] = pressures
        curves = {"direction": "column", "first": curves, "second": "Plot!pressure", "splitPercentage": 67}
    side = {"direction": "column", "first": curves, "second": below, "splitPercentage": 60}
    layout = {"direction": "row", "first": "3D!robot", "second": side, "splitPercentage": 60}
    rest: dict[str, Any] = {"globalVariables": {}, "userNodes": {}, "playbackConfig": {"speed": 1}}
    return json.dumps({"configById": panels, **rest, "layout": layout}, indent=2) + "\n"


def _curves(robot: RobotDescription, topic: str, field: str) -> dict[str, Any]:
    paths = [
        {"value": f"{topic}.{field}[{index}]", "label": name, "enabled": True}
        for index, name in enumerate(robot.joint_names)
    ]
    return _plot(field, paths)


def _pressures(robot: RobotDescription, start: str) -> dict[str, Any]:
    """Curves of the chambers in [Pa] against vacuum; empty for a robot without."""
    paths = [
        {"value": f"{start}{topic}.fluid_pressure", "label": robot.joint_names[index], "enabled": True}
        for index, topic in chambers_of(robot.joints).items()
    ]
    return _plot("pressure", paths) if paths else {}


def _plot(title: str, paths: list[dict[str, Any]]) -> dict[str, Any]:
    return {"title": title, "paths": paths, "showLegend": True, "followingViewWidth": 20}
