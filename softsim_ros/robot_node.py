"""What the nodes for one robot have in common: which robot, its namespace, its diagnostics."""

from __future__ import annotations

import os
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import ClassVar

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter

from softsim_core import RobotDescription, load_scene
from softsim_ros.frames import RobotFrames, prefix_of
from softsim_ros.messages import diagnostic_array
from softsim_ros.runtime import ClosableNode, declare_text, parameter_probe

DEFAULT_ROBOT = "tripod"


class RobotNode(ClosableNode):
    """A node for one robot or scene, in the robot's namespace.

    Args:
        robot: Name or path of the robot, or the robot itself; None takes the parameter `robot`.
        context: rclpy context; None takes the default one.
        namespace: None takes the robot's name; `-r __ns:=/other` on the command line wins over both.
        parameter_overrides: Values at start, over those of the command line.

    Attributes:
        node_name: Name of the node.
        changes_robot: Whether the parameter `robot` may be set while the node runs.
        robot: Name of the robot.
        frames: Names of the robot's frames in headers.
        named: The file of the robot that the node was started with, by its names; empty: it has none.

    Raises:
        SoftSimError: the robot is not known, or what a subclass refuses.
    """

    node_name: ClassVar[str]
    changes_robot: ClassVar[bool] = False

    def __init__(
        self,
        robot: str | os.PathLike[str] | RobotDescription | None = None,
        *,
        context: Context | None = None,
        namespace: str | None = None,
        parameter_overrides: Sequence[Parameter] = (),
    ) -> None:
        overrides = list(parameter_overrides)
        if robot is None:
            with parameter_probe(self.node_name, context=context, parameter_overrides=overrides) as probe:
                robot = self._declare_robot(probe)
        scene = robot if isinstance(robot, RobotDescription) else load_scene(robot)
        self.robot = scene.name
        text = scene.name if isinstance(robot, RobotDescription) else str(robot)
        self.named = {} if scene.source is None else {text: scene.source, scene.name: scene.source}
        super().__init__(
            self.node_name,
            context=context,
            namespace=scene.namespace if namespace is None else namespace,
            parameter_overrides=overrides,
        )
        try:
            self._declare_robot(self, text)
            self.frames = RobotFrames(self._declare_prefix())
            self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
            self._begin(scene)
        except BaseException:
            self.close()
            raise

    @abstractmethod
    def _begin(self, robot: RobotDescription) -> None:
        """Declare parameters, make topics and services, start; an error here closes the node."""

    def _declare_robot(self, node: Node, default: str = DEFAULT_ROBOT) -> str:
        return declare_text(
            node,
            "robot",
            default,
            "Robot or scene: a name such as tripod; at the start also the path of a .yaml or .py file",
            read_only=not self.changes_robot,
        )

    def _declare_prefix(self) -> str:
        return declare_text(
            self,
            "frame_prefix",
            prefix_of(self.get_namespace()),
            "Stands before the names of the robot's frames in headers and on /tf; all but `world`",
        )

    def _publish_health(self, level: bytes, sentence: str, values: Mapping[str, object]) -> None:
        """Tell /diagnostics how the node is."""
        name = f"{self.get_namespace().strip('/')}/{self.get_name()}".lstrip("/")
        stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(diagnostic_array(stamp, name, self.robot, level, sentence, values))
