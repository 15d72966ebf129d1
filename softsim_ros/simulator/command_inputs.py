"""Where commands for the joints come in: three topics and, where control_msgs is installed, an action.

And where joints are followed that somebody else moves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final

from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory as JointTrajectoryMessage

from softsim_core.errors import CommandError
from softsim_node.guarded_node import GuardedNode
from softsim_node.parameters import ParameterError
from softsim_ros.simulator.commands import (
    named_command,
    position_command,
    seconds,
    trajectory_command,
    trajectory_delay,
)
from softsim_ros.simulator.physics_thread import PhysicsThread
from softsim_ros.simulator.trajectory_action import TrajectoryAction

NAMED_DEPTH: Final = 10
"""Commands by name that may wait: each may be for other joints."""


class CommandInputs:
    """Hands commands to the physics; the newest of all of them wins.

    Args:
        node: Owner of the subscriptions.
        physics: The thread that owns the simulation.
        joint_names: Tells the joints that there are.
        now_s: The time now in [s], on the clock of the stamps.
        followed: Topic of joint states that joints of the same names follow; empty: none.

    Attributes:
        action: FollowJointTrajectory.
    """

    def __init__(
        self,
        node: GuardedNode,
        physics: PhysicsThread,
        joint_names: Callable[[], Sequence[str]],
        now_s: Callable[[], float],
        followed: str = "",
    ) -> None:
        self._node, self._physics, self._joint_names, self._now_s = node, physics, joint_names, now_s
        node.create_subscription(Float64MultiArray, "position_controller/commands", self._on_positions, 1)
        node.create_subscription(JointState, "joint_commands", self._on_named, NAMED_DEPTH)
        node.create_subscription(JointTrajectoryMessage, "joint_trajectory", self._on_trajectory, 1)
        if followed:
            self._follow(followed)
        self.action = TrajectoryAction(node, physics, now_s)

    def _follow(self, topic: str) -> None:
        if self._node.resolve_topic_name(topic) == self._node.resolve_topic_name("joint_states"):
            raise ParameterError(
                f"parameter follow_joint_states = {topic} is refused: the simulator sends that itself; name "
                "the topic of the arm's driver"
            )
        self._node.create_subscription(JointState, topic, self._on_followed, qos_profile_sensor_data)

    def _on_followed(self, message: JointState) -> None:
        """Names that the robot has not, and what is no number, are left out."""
        known = self._joint_names()
        positions = {
            name: float(position)
            for name, position in zip(message.name, message.position, strict=False)
            if name in known and math.isfinite(position)
        }
        if positions:
            self._physics.led.hear(positions, seconds(message.header.stamp))

    def _on_positions(self, message: Float64MultiArray) -> None:
        try:
            self._physics.command(position_command(message, self._joint_names()))
        except CommandError as error:
            self._node.refuse(str(error))

    def _on_named(self, message: JointState) -> None:
        try:
            self._physics.command_named(named_command(message, self._joint_names(), self._now_s()))
        except CommandError as error:
            self._node.refuse(str(error))

    def _on_trajectory(self, message: JointTrajectoryMessage) -> None:
        try:
            delay = trajectory_delay(message, self._now_s())
            self._physics.command(trajectory_command(message, self._joint_names()), delay)
        except CommandError as error:
            self._node.refuse(str(error))
