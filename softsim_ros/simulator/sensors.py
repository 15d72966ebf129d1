"""What the sensors of a scene tell, as `sensors/NAME`, and all contacts, as `contacts/points`.

Each sensor has the standard message of its kind, see messages.sensors, once a sample, with the stamp of the
step that it was taken in. `contacts/points` (sensor_msgs/PointCloud2) has every contact of the step.
"""

from __future__ import annotations

from typing import Any

from builtin_interfaces.msg import Time
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import PointCloud2

from softsim_core.actuation.chamber import ATMOSPHERE, ChamberDescription
from softsim_core.scene.robot import RobotDescription
from softsim_core.sensing import (
    ForceTorqueDescription,
    ImuDescription,
    SensorReading,
    SimulatedSensorDescription,
    WrenchSensorDescription,
)
from softsim_core.simulation import Simulation
from softsim_ros import messages
from softsim_ros.frames import WORLD
from softsim_ros.messages.contacts import contact_cloud
from softsim_ros.messages.sensors import Told, told_of
from softsim_ros.qos import EVERY_ONE, NEWEST_ONLY
from softsim_ros.simulator.transforms import FrameTree
from softsim_ros.topic_names import topic_words


class SensorPublications:
    """Publishers of what sensors tell; used from the physics thread.

    Args:
        node: Owner of the publishers.
        base: Frame of what is measured in no frame of its own.
    """

    def __init__(self, node: Node, base: str) -> None:
        self._node, self._base = node, base
        self._contacts = node.create_publisher(PointCloud2, "contacts/points", NEWEST_ONLY)
        self._publishers: dict[tuple[str, type], Publisher] = {}
        self._sensors: list[tuple[str, str, list[tuple[Publisher, Told]]]] = []  # name, frame, what is sent
        self._sent: dict[str, SensorReading] = {}

    def show_scene(self, simulation: Simulation, tree: FrameTree) -> None:
        """Have publishers for a scene's sensors and no others; a topic that stays keeps its publisher.

        The node must not be served meanwhile: its callback waits until the physics has taken the scene.
        """
        described = simulation.scene.sensors
        words = topic_words([each.name for each in described], "sensor")
        before, self._publishers, self._sent = self._publishers, {}, {}
        wanted = [
            (
                sensor,
                [
                    (f"sensors/{word}{told.below}", told)
                    for told in told_of(sensor, _around(sensor, simulation.robot))
                ],
            )
            for sensor, word in zip(described, words, strict=True)
        ]
        kept = {(topic, told.message) for _, topics in wanted for topic, told in topics}
        for key in before.keys() - kept:
            self._node.destroy_publisher(before.pop(key))
        self._sensors = []
        for sensor, topics in wanted:
            sends = []
            for topic, told in topics:
                key = (topic, told.message)
                publisher = before.get(key) or self._node.create_publisher(told.message, topic, EVERY_ONE)
                self._publishers[key] = publisher
                sends.append((publisher, told))
            self._sensors.append((sensor.name, self._frame(sensor, tree), sends))

    def publish(self, simulation: Simulation, stamp: Time, whole: bool) -> None:
        """Send new samples to who listens; `whole` asks for all of them."""
        for name, frame, sends in self._sensors:
            reading = simulation.sensors[name]
            if reading is self._sent.get(name) and not whole:
                continue
            self._sent[name] = reading
            header: Any = None
            for publisher, told in sends:
                if publisher.get_subscription_count():
                    header = header or messages.header(stamp, frame)
                    publisher.publish(told.write(header, reading))
        if self._contacts.get_subscription_count():
            self._contacts.publish(contact_cloud(stamp, WORLD, simulation.contacts))

    def _frame(self, sensor: SimulatedSensorDescription, tree: FrameTree) -> str:
        if isinstance(sensor, (ForceTorqueDescription, ImuDescription)):
            return tree.of_sensor(sensor.name)
        if isinstance(sensor, WrenchSensorDescription):
            return tree.of_place(sensor.on)
        return WORLD if sensor.kind == "markers" else self._base


def _around(sensor: SimulatedSensorDescription, robot: RobotDescription) -> float:
    """Pressure in [Pa], against vacuum, of the air around the joint that a sensor is on."""
    name = getattr(sensor, "joint", None)
    actuator = next((joint.actuator for joint in robot.joints if joint.name == name), None)
    return actuator.atmosphere if isinstance(actuator, ChamberDescription) else ATMOSPHERE
