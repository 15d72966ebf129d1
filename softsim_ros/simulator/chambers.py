"""The pressure in each chamber as `chambers/JOINT/pressure` (sensor_msgs/FluidPressure), once a step.

A joint's effort is the pressure against the air around; the message wants it against vacuum. So the pressure
of the atmosphere that the scene names is added, at any height. The variance is 0: unknown.
"""

from __future__ import annotations

from typing import Final

from builtin_interfaces.msg import Time
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import FluidPressure

from softsim_core.actuation.chamber import ChamberDescription
from softsim_core.simulation import Simulation
from softsim_ros import messages
from softsim_ros.chamber_topics import chambers_of

DEPTH: Final = 10


class ChamberPublications:
    """Publishers of the chambers' pressures; a robot without chambers has none.

    Args:
        node: Owner of the publishers.
        frame: Frame that the messages name.
    """

    def __init__(self, node: Node, frame: str) -> None:
        self._node, self._frame = node, frame
        self._publishers: dict[str, Publisher] = {}
        self._joints: list[tuple[int, float]] = []  # and the atmosphere in [Pa] around each

    def show_scene(self, simulation: Simulation) -> None:
        """Have publishers for a scene's chambers and no others; a topic that stays keeps its publisher.

        The node must not be served meanwhile: its callback waits until the physics has taken the scene.
        """
        joints = simulation.robot.joints
        chambers = chambers_of(joints)
        self._joints = []
        for number in chambers:
            chamber = joints[number].actuator
            assert isinstance(chamber, ChamberDescription)
            self._joints.append((number, chamber.atmosphere))
        topics = list(chambers.values())
        before, self._publishers = self._publishers, {}
        for topic in before.keys() - set(topics):
            self._node.destroy_publisher(before.pop(topic))
        for topic in topics:
            self._publishers[topic] = before.get(topic) or self._node.create_publisher(
                FluidPressure, topic, DEPTH
            )

    def publish(self, simulation: Simulation, stamp: Time) -> None:
        """Send all pressures."""
        if not self._joints:
            return
        efforts = simulation.joint_efforts
        for (joint, around), publisher in zip(self._joints, self._publishers.values(), strict=True):
            pressure = around + float(efforts[joint])
            publisher.publish(messages.fluid_pressure(stamp, self._frame, pressure))
