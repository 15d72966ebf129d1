"""Base of the nodes for one robot: its description, namespace, diagnostics and callbacks."""

from __future__ import annotations

import os
import threading
from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import ClassVar

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter

from softsim_core import RobotDescription, load_scene
from softsim_node import GuardedNode, RobotFrames, declare, parameter, parameter_probe, prefix_of, spin
from softsim_ros.messages import diagnostic_array


class SpinThread:
    """Runs callbacks of some nodes in their own thread; leaving the `with` block stops and joins it."""

    def __init__(self, nodes: Iterable[Node], context: Context | None = None) -> None:
        self.executor = SingleThreadedExecutor(context=context)
        for node in nodes:
            self.executor.add_node(node)
        self._stop = threading.Event()
        self._thread = threading.Thread(
            target=spin, args=(self.executor, lambda: not self._stop.is_set()), name="spin"
        )

    def __enter__(self) -> SpinThread:
        """Start the thread."""
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop and join the thread; the nodes are not destroyed."""
        self.close()

    def close(self) -> None:
        """Stop and join the thread, if it was started."""
        self._stop.set()
        if self._thread.is_alive():
            with suppress(Exception):  # the guard condition ends with its context, and so does the loop
                self.executor.wake()
            self._thread.join()
        self.executor.shutdown(timeout_sec=0)


@dataclass(frozen=True, kw_only=True)
class RobotSettings:
    """Common parameters of every node for one robot."""

    robot: str = parameter(
        "tripod",
        "Robot or scene: a name such as tripod; at the start also the path of a .yaml or .py file",
        fixed=True,
    )


@dataclass(frozen=True)
class FrameSettings:
    """The parameter of every node that names frames of one robot."""

    frame_prefix: str = parameter(
        "", "Stands before the robot's frames in headers and on /tf; from its namespace", fixed=True
    )


class RobotNode(GuardedNode):
    """A node for one robot or scene, in the robot's namespace.

    Args:
        robot: Name or path of the robot, or the robot itself; None takes the parameter `robot`.
        context: rclpy context; None takes the default one.
        namespace: None takes the robot's name; `-r __ns:=/other` on the command line overrides both.
        parameter_overrides: Values at the start, which override those of the command line.

    Attributes:
        node_name: Name of the node.
        robot: Name of the robot.
        robot_parameter: Value of the parameter `robot`, which a subclass declares.
        frames: Names of the robot's frames in headers.
        named: The robot's file with which the node was started, by its names; empty: it has none.

    Raises:
        SoftSimError: the robot is not known, or the subclass refuses it.
    """

    node_name: ClassVar[str]

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
                robot = declare(probe, RobotSettings()).robot
        scene = robot if isinstance(robot, RobotDescription) else load_scene(robot)
        self.robot = scene.name
        self.robot_parameter = scene.name if isinstance(robot, RobotDescription) else str(robot)
        names = (self.robot_parameter, scene.name)
        self.named = {} if scene.source is None else dict.fromkeys(names, scene.source)
        super().__init__(
            self.node_name,
            context=context,
            namespace=scene.namespace if namespace is None else namespace,
            parameter_overrides=overrides,
        )
        try:
            self.frames = RobotFrames(
                declare(self, FrameSettings(prefix_of(self.get_namespace()))).frame_prefix
            )
            self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
            self._begin(scene)
        except BaseException:
            self.close()
            raise

    @abstractmethod
    def _begin(self, robot: RobotDescription) -> None:
        """Declare parameters, create topics and services, start; an error here closes the node."""

    def _publish_health(self, level: bytes, message: str, values: Mapping[str, object]) -> None:
        """Publish the node's status on /diagnostics."""
        name = f"{self.get_namespace().strip('/')}/{self.get_name()}".lstrip("/")
        stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(diagnostic_array(stamp, name, self.robot, level, message, values))
