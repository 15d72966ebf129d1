"""The pressure in each chamber as `chambers/JOINT/pressure` (sensor_msgs/FluidPressure), once a step.

A joint's effort is the pressure against the air around; the message wants it against vacuum. So the pressure
of the atmosphere that the scene names is added, at any height. The variance is 0: unknown.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

from builtin_interfaces.msg import Time
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import FluidPressure

from softsim_core.actuation.chamber import ChamberDescription
from softsim_core.simulation import Simulation
from softsim_ros import messages

DEPTH: Final = 10
LONGEST_NAME: Final = 60
"""So much of a joint's name stands in its topic; ROS allows about 250 characters for a topic in all."""


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
        self._joints = [
            (number, joint.actuator.atmosphere)
            for number, joint in enumerate(joints)
            if isinstance(joint.actuator, ChamberDescription)
        ]
        topics = chamber_topics([joints[number].name for number, _ in self._joints])
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


def chamber_topics(names: Sequence[str]) -> list[str]:
    """The topics of chambers by the names of their joints; what no topic may hold becomes an underscore."""
    topics: list[str] = []
    for name in names:
        token = re.sub(r"[^A-Za-z0-9_]", "_", name[:LONGEST_NAME])
        if not token[:1].isalpha():
            token = f"chamber_{token}"
        while f"chambers/{token}/pressure" in topics:
            token = f"{token}_"
        topics.append(f"chambers/{token}/pressure")
    return topics
