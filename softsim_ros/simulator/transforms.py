"""The robot's frames as transforms: one tree with `world` as its root, whatever else is in the graph."""

from __future__ import annotations

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped

from softsim_core.arrays import Array
from softsim_core.mechanics.pose import quaternion_of, rotation_euler, rotation_of
from softsim_core.sensing import ForceTorqueDescription, ImuDescription
from softsim_core.simulation import Simulation
from softsim_ros.description.links import Link, links_of, moved_link
from softsim_ros.frames import BASE_LINK, WORLD, RobotFrames
from softsim_ros.messages import transform_stamped


class FrameTree:
    """Transforms of a simulation's links and of its rigid bodies.

    A link that the simulation measures is where it is, with moved bases too; a rigid body that no link shows
    hangs on `world`, under its name.

    Args:
        simulation: Whose frames; of another scene another tree is made.
        frames: Names of the frames.
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
        framed = (ForceTorqueDescription, ImuDescription)
        units = [each for each in simulation.scene.sensors if isinstance(each, framed)]
        taken = names | set(self._objects.values())
        self._units = {
            each.name: (each, f"{each.name}_sensor" if each.name in taken else each.name) for each in units
        }

    def of_sensor(self, name: str) -> str:
        """The frame of a sensor that has one of its own, fixed in what it sits on: an IMU."""
        return self._frames.of(self._units[name][1])

    def of_place(self, name: str) -> str:
        """The frame of what a sensor may sit on, by the name that the scene gives it."""
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
        """The frame of a rigid body, by its number and name in the scene."""
        return self._frames.of(self._objects[number] if number in self._objects else self._carried[name])

    def still(self, stamp: Time) -> list[TransformStamped]:
        """What never moves: `world` to the base, and what is fixed to another link."""
        base = transform_stamped(stamp, WORLD, self._frames.base, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        links = [self._transform(stamp, link, *link.pose(0.0)) for link in self._still]
        return [base, *links, *(self._unit(stamp, unit, name) for unit, name in self._units.values())]

    def _unit(
        self, stamp: Time, unit: ForceTorqueDescription | ImuDescription, name: str
    ) -> TransformStamped:
        turn = quaternion_of(rotation_euler(np.radians(unit.pose.rotation_deg)))
        parent, child = self.of_place(unit.on), self._frames.of(name)
        return transform_stamped(stamp, parent, child, unit.pose.translation, turn)

    def moving(self, simulation: Simulation, stamp: Time) -> list[TransformStamped]:
        """What moves, as it is now."""
        measured, positions = simulation.frames(), simulation.joint_positions
        world: dict[str, tuple[Array, Array]] = {BASE_LINK: (np.zeros(3), np.eye(3))}
        transforms = []
        for link in self._moving:
            origin, turn = world[link.parent]
            if link.measured:
                pose = measured[link.measured]
                world[link.name] = pose.position, rotation_of(pose.quaternion_xyzw)
                place = turn.T @ (pose.position - origin), turn.T @ world[link.name][1]
            else:
                place = link.pose(float(positions[self._joints[link.joint]]))
                world[link.name] = origin + turn @ place[0], turn @ place[1]
            transforms.append(self._transform(stamp, link, *place))
        poses = simulation.rigid_poses if self._objects else ()
        for number, name in self._objects.items():
            pose, frame = poses[number], self._frames.of(name)
            transforms.append(transform_stamped(stamp, WORLD, frame, pose.position, pose.quaternion_xyzw))
        return transforms

    def _transform(self, stamp: Time, link: Link, position: Array, rotation: Array) -> TransformStamped:
        parent, child = self._frames.of(link.parent), self._frames.of(link.name)
        return transform_stamped(stamp, parent, child, position, quaternion_of(rotation))
