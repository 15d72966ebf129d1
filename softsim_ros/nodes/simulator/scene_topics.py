"""Frames of the robot as transforms, and the structure of its scene as a message."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from std_msgs.msg import MultiArrayDimension, MultiArrayLayout, UInt32MultiArray

from softsim_core.base import Array
from softsim_core.physics.mechanics import FIXED, quaternion_of, rotation_euler, rotation_of
from softsim_core.physics.sensing import Mount
from softsim_core.scene.io import places_of, write_description
from softsim_core.simulation import Simulation
from softsim_node import BASE_LINK, WORLD, RobotFrames
from softsim_ros import messages
from softsim_ros.description import Link, links_of, moved_link
from softsim_ros.messages import transform_stamped


class FrameTree:
    """Transforms of a simulation's links and of its rigid bodies.

    A link with a measured pose gets that pose, also with moved bases. A rigid body without a link is a child
    of `world`, under its own name. Another scene needs another tree.
    """

    def __init__(self, simulation: Simulation, frames: RobotFrames) -> None:
        self._frames = frames
        links = links_of(simulation.robot)
        self._still = [link for link in links if link.kind == "fixed" and not link.measured]
        self._moving = [link for link in links if link not in self._still]
        self._joints = {name: number for number, name in enumerate(simulation.joint_names)}
        names = {link.name for link in links}
        shown = {link.part for link in links}
        self._objects = {
            number: body.name if body.name not in names else f"{body.name}_body"
            for number, body in enumerate(simulation.rigid_bodies)
            if f"rigid_bodies/{body.name}" not in shown
        }
        self._carried = {
            link.part.partition("/")[2]: link.name for link in links if link.part.startswith("rigid_bodies/")
        }

        self._of_free = {link.part.partition("/")[2]: link.name for link in links if link.kind == "floating"}
        self._scene = simulation.scene
        taken = names | set(self._objects.values())
        self._units = {
            each.name: (each.mount, f"{each.name}_sensor" if each.name in taken else each.name)
            for each in simulation.scene.sensors
            if each.mount is not None
        }

    def of_sensor(self, name: str) -> str:
        """Return the frame of a sensor that has its own, such as an IMU, fixed to the sensor's mount."""
        return self._frames.of(self._units[name][1])

    def of_place(self, name: str) -> str:
        """Return the frame of a part that sensors may be mounted on, by its name in the scene."""
        scene = self._scene
        name = next((each.to for each in scene.attachments if each.name == name and each.to != "free"), name)
        if name == WORLD:
            return WORLD
        if name in self._of_free:
            return self._frames.of(self._of_free[name])
        if joint := next((each for each in scene.joints if each.name == name and each.moves_frame), None):
            return self._frames.of(moved_link(joint))
        bodies = [body.name for body in scene.rigid_bodies]
        if name in bodies:
            return self.of_body(bodies.index(name), name)
        return self._frames.of(name)  # the base of a joint

    def of_body(self, number: int, name: str) -> str:
        """Return the frame of a rigid body, by its number and name in the scene."""
        return self._frames.of(self._objects[number] if number in self._objects else self._carried[name])

    def still(self, stamp: Time) -> list[TransformStamped]:
        """Return the static transforms: `world` to the base, fixed links, and sensors."""
        base = transform_stamped(stamp, WORLD, self._frames.base, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        links = [self._transform(stamp, link, *link.pose(0.0)) for link in self._still]
        return [base, *links, *(self._unit(stamp, unit, name) for unit, name in self._units.values())]

    def _unit(self, stamp: Time, mount: Mount, name: str) -> TransformStamped:
        turn = quaternion_of(rotation_euler(np.radians(mount.pose.rotation_deg)))
        parent, child = self.of_place(mount.on), self._frames.of(name)
        return transform_stamped(stamp, parent, child, mount.pose.translation, turn)

    def moving(self, simulation: Simulation, stamp: Time) -> list[TransformStamped]:
        """Return the current transforms of moving links and rigid bodies."""
        measured, positions = simulation.frames(), simulation.joint_positions
        world: dict[str, tuple[Array, Array]] = {BASE_LINK: (np.zeros(3), np.eye(3))}
        transforms = []
        for link in self._moving:
            origin, turn = world[link.parent]
            if link.measured:
                pose = measured[link.measured]
                world[link.name] = pose.position, rotation_of(pose.quaternion_xyzw)
                relative = turn.T @ (pose.position - origin), turn.T @ world[link.name][1]
            else:
                relative = link.pose(float(positions[self._joints[link.joint]]))
                world[link.name] = origin + turn @ relative[0], turn @ relative[1]
            transforms.append(self._transform(stamp, link, *relative))
        poses = simulation.rigid_poses if self._objects else ()
        for number, name in self._objects.items():
            pose, frame = poses[number], self._frames.of(name)
            transforms.append(transform_stamped(stamp, WORLD, frame, pose.position, pose.quaternion_xyzw))
        return transforms

    def _transform(self, stamp: Time, link: Link, position: Array, rotation: Array) -> TransformStamped:
        parent, child = self._frames.of(link.parent), self._frames.of(link.name)
        return transform_stamped(stamp, parent, child, position, quaternion_of(rotation))


def structure(
    simulation: Simulation, overrides: str = "", scenes: Sequence[str] = (), generation: int = 0
) -> dict[str, Any]:
    """Return the parts of a scene as plain values: all that a program needs to draw it without its files.

    Returns:
        `generation`, a number that grows with every scene, across restarts too; `name`; `description`, the
        scene as YAML text with every value; `overrides`, YAML text of the values that override its file;
        `scenes`, names that the parameter `robot` accepts; `places`, file and line of each part, by its steps
        such as "joints/servo_0/base"; `dt` in [s]; `frames`, names in the order of the topic `frames`;
        `bodies`, each with `name`, `points` and `triangles` (first and end index in mesh/topology), `nodes`
        (first and end index in mesh/nodes) and `colour` (red, green, blue, alpha in 0..1); `body_names`, of
        all bodies, by the numbers that `contacts/points` gives them; `regions`, each a rigid region with
        `name`, `to` ("world", "free" or a joint) and `nodes`; `checksums`, by their topics, of the meshes
        that belong to this generation.
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
    fixed_nodes = np.flatnonzero((model.region_of_node == FIXED) | (model.spring > 0.0))
    if len(fixed_nodes):
        regions.append({"name": "fixings", "to": "world", "nodes": fixed_nodes.tolist()})
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
    """Return rows of indices (r, c) as a message, with r and c in its layout."""
    indices = np.asarray(rows, dtype=np.uint32)
    count, width = indices.shape
    layout = MultiArrayLayout(
        dim=[
            MultiArrayDimension(label="elements", size=count, stride=count * width),
            MultiArrayDimension(label="corners", size=width, stride=width),
        ]
    )
    return UInt32MultiArray(layout=layout, data=messages.message_array(indices, "I"))
