"""What RViz shows of a robot: its description, bodies, stress, cables, chambers, contacts, collisions, goal.

Topics are relative: RViz runs in the robot's namespace.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import yaml

from softsim_core import RobotDescription
from softsim_ros.description.links import links_of
from softsim_ros.frames import WORLD


class Shown(NamedTuple):
    """A topic that is shown.

    Attributes:
        topic: Its name in the robot's namespace.
        type_name: Its type, such as "visualization_msgs/msg/Marker".
        kind: RViz's display for it.
        name: What people call it.
        enabled: Whether it is shown from the start.
        latched: Whether it is sent once, to late joiners too.
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
    Shown("mesh/marker", "visualization_msgs/msg/Marker", "Marker", "Silicone"),
    Shown(
        "mesh/points", "sensor_msgs/msg/PointCloud2", "PointCloud2", "Stress", enabled=False, options=_CLOUD
    ),
    Shown("cables", _MARKERS, "MarkerArray", "Cables"),
    Shown("chambers", _MARKERS, "MarkerArray", "Pressure chambers"),
    Shown("bodies/topology", _MARKERS, "MarkerArray", "Rigid bodies", latched=True),
    Shown("contacts", _MARKERS, "MarkerArray", "Contacts"),
    Shown("collisions", _MARKERS, "MarkerArray", "Collision surfaces", enabled=False),
    Shown("effector_pose", _POSE, "Pose", "Effector", options=_AXES),
    Shown("effector_goal", _POSE, "Pose", "Goal", options={"Color": "255; 25; 0", **_AXES}),
)


def rviz_config(robot: RobotDescription, frame_prefix: str) -> str:
    """The text of an .rviz file.

    Args:
        robot: What is shown.
        frame_prefix: Of its frames, such as "left/".
    """
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
