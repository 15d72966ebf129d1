"""What a scene is made of, for programs that draw it: parts once, nodes and frames while somebody listens.

Topics: `scene/structure` (std_msgs/String, latched) is a JSON object, see `structure`; `mesh/tetrahedra`
(std_msgs/UInt32MultiArray, latched) has the node indices of all elements; `mesh/nodes`
(sensor_msgs/PointCloud2) has the nodes as mesh/points has the visible vertices, 10 Hz; `frames`
(geometry_msgs/PoseArray) has the poses in `world` of the frames that the structure names, 30 Hz.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseArray
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import MultiArrayDimension, MultiArrayLayout, String, UInt32MultiArray

from softsim_core.mechanics.model import FIXED
from softsim_core.scene.location import places_of
from softsim_core.scene.portable import write_description
from softsim_core.simulation import Simulation
from softsim_ros import messages
from softsim_ros.qos import LATCHED
from softsim_ros.simulator.pacing import RateGate

NODES_PERIOD_S = 0.1
FRAMES_PERIOD_S = 1.0 / 30.0


class StructurePublications:
    """Publishers of a scene's inner structure; used from the thread that owns the simulation.

    Args:
        node: Owner of the publishers.
    """

    def __init__(self, node: Node) -> None:
        self._structure = node.create_publisher(String, "scene/structure", LATCHED)
        self._tetrahedra = node.create_publisher(UInt32MultiArray, "mesh/tetrahedra", LATCHED)
        self._nodes = node.create_publisher(PointCloud2, "mesh/nodes", 1)
        self._frames = node.create_publisher(PoseArray, "frames", 1)
        self._generation = 0
        self._nodes_gate, self._frames_gate = RateGate(NODES_PERIOD_S), RateGate(FRAMES_PERIOD_S)

    def show_scene(self, simulation: Simulation, overrides: str = "", scenes: Sequence[str] = ()) -> None:
        """Send what does not move, of a scene with `overrides` laid over its file, and names of others."""
        self._generation = max(self._generation + 1, time.time_ns())
        told = structure(simulation, overrides, scenes, self._generation)
        self._tetrahedra.publish(index_array(simulation.tets))
        self._structure.publish(String(data=json.dumps(told)))

    def publish(self, simulation: Simulation, stamp: Time, now: float, whole: bool) -> None:
        """Send what is due; `now` is a steady clock in [s], `whole` asks for everything at once."""
        if self._frames.get_subscription_count() and (self._frames_gate.passes(now) or whole):
            poses = [messages.pose(p.position, p.quaternion_xyzw) for p in simulation.frames().values()]
            self._frames.publish(PoseArray(header=messages.header(stamp, "world"), poses=poses))
        if self._nodes.get_subscription_count() and (self._nodes_gate.passes(now) or whole):
            stress = simulation.von_mises()
            self._nodes.publish(messages.point_cloud(stamp, "world", simulation.positions, stress))


def structure(
    simulation: Simulation, overrides: str = "", scenes: Sequence[str] = (), generation: int = 0
) -> dict[str, Any]:
    """The parts of a scene as plain values: all that a program needs which draws it, without its files.

    Returns:
        `generation`, a number that grows with every scene, across restarts too; `name`; `description`, the
        scene as YAML text with every value; `overrides`, YAML text of what is laid over its file; `scenes`,
        names of those that the parameter `robot` takes; `places`, file and line of each part, by its steps
        such as "joints/servo_0/base"; `dt` in [s]; `frames`, names in the order of the topic `frames`;
        `bodies`, each with `name`, `points` and `triangles` (first and end index in mesh/topology), `nodes`
        (first and end index in mesh/nodes) and `colour` (red, green, blue, alpha in 0..1); `body_names`, of
        all bodies, by the numbers that `contacts/points` gives them; `regions`, each a
        rigid region with `name`, `to` ("world", "free" or a joint) and `nodes`; `checksums`, by their topics,
        of the meshes that belong to this generation.
    """
    scene, model, source = simulation.scene, simulation.model, simulation.robot.source
    bodies, point, triangle = [], 0, 0
    for body, description in zip(simulation.bodies, scene.bodies, strict=True):
        points, triangles = len(body.surface.points), len(body.surface.triangles)
        bodies.append(
            {
                "name": body.name,
                "points": [point, point + points],
                "triangles": [triangle, triangle + triangles],
                "nodes": [body.nodes.start, body.nodes.stop],
                "colour": list(description.colour),
            }
        )
        point, triangle = point + points, triangle + triangles
    targets = {attachment.name: attachment.to for attachment in scene.attachments}
    regions = [
        {"name": region.name, "to": targets.get(region.name, "free"), "nodes": region.nodes.tolist()}
        for region in model.regions
    ]
    held = np.flatnonzero((model.region_of_node == FIXED) | (model.spring > 0.0))
    if len(held):
        regions.append({"name": "fixings", "to": "world", "nodes": held.tolist()})
    return {
        "generation": generation,
        "name": scene.name,
        "description": write_description(simulation.robot),
        "overrides": overrides,
        "scenes": list(scenes),
        "places": {} if source is None else places_of(source),
        "dt": simulation.dt,
        "frames": list(simulation.frames()),
        "bodies": bodies,
        "body_names": list(scene.body_names),
        "regions": regions,
        "checksums": {
            "mesh/topology": messages.mesh_checksum(
                simulation.visual_triangles, simulation.visual_rest_points
            ),
            "mesh/tetrahedra": messages.mesh_checksum(simulation.tets),
        },
    }


def index_array(rows: Any) -> UInt32MultiArray:
    """Rows of indices (r, c) as a message whose layout tells r and c."""
    indices = np.asarray(rows, dtype=np.uint32)
    count, width = indices.shape
    layout = MultiArrayLayout(
        dim=[
            MultiArrayDimension(label="elements", size=count, stride=count * width),
            MultiArrayDimension(label="corners", size=width, stride=width),
        ]
    )
    return UInt32MultiArray(layout=layout, data=messages.message_array(indices, "I"))
