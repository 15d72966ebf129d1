"""Whether the simulator still runs the robot that a model was made of; the latched scene tells it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from rclpy.node import Node
from std_msgs.msg import String

from softsim_core.contact.settings import ContactSettings
from softsim_core.errors import SoftSimError
from softsim_core.scene.description import SceneDescription
from softsim_core.scene.robot import RobotDescription
from softsim_ros.messages.scene_message import SceneMessage, read_scene_message
from softsim_ros.qos import LATCHED

_NO_COLOUR = (0.0, 0.0, 0.0, 0.0)


class SimulatedRobot:
    """Follows `scene/structure` of a node's namespace; on a bare robot it stays silent.

    The scene that is heard of first counts as the model's: a model may be coarser than what is simulated.

    Args:
        node: Its executor delivers the messages.
        changed: Told a sentence when another robot has come, and an empty text when the first one is back.
        refuse: Told a sentence for a message that cannot be read.
    """

    def __init__(self, node: Node, changed: Callable[[str], None], refuse: Callable[[str], None]) -> None:
        self._changed, self._refuse = changed, refuse
        self._generation = 0
        self._first: SceneDescription | None = None
        self._sentence = ""
        node.create_subscription(String, "scene/structure", self._on_scene, LATCHED)

    def _on_scene(self, message: String) -> None:
        try:
            told = read_scene_message(message.data)
        except SoftSimError as error:
            self._refuse(str(error))
            return
        if told.generation <= self._generation:
            return
        self._generation = told.generation
        mechanics = mechanics_of(told.robot)
        if self._first is None:
            self._first = mechanics
        before, self._sentence = self._sentence, "" if mechanics == self._first else _other(told)
        if self._sentence != before:
            self._changed(self._sentence)


def mechanics_of(robot: RobotDescription) -> SceneDescription:
    """What a model of the robot alone is made of: no name, no looks, nothing that it touches."""
    alone = robot.robot_alone().scene
    bodies = tuple(replace(body, surface=None, colour=_NO_COLOUR) for body in alone.bodies)
    return replace(alone, name="robot", bodies=bodies, contact=ContactSettings())


def _other(told: SceneMessage) -> str:
    source = told.robot.source
    return (
        f"the simulator runs another robot now ({told.robot.name if source is None else source.stem}) than "
        "the one that the model was made of; load that again, or start inverse control anew"
    )
