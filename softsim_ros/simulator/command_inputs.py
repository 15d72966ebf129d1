"""Where commands for the joints come in: three topics and, where control_msgs is installed, an action."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory as JointTrajectoryMessage

from softsim_core.errors import CommandError
from softsim_node.guarded_node import GuardedNode
from softsim_ros.simulator.commands import (
    named_command,
    position_command,
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

    Attributes:
        action: FollowJointTrajectory.
    """

    def __init__(
        self,
        node: GuardedNode,
        physics: PhysicsThread,
        joint_names: Callable[[], Sequence[str]],
        now_s: Callable[[], float],
    ) -> None:
        self._node, self._physics, self._joint_names, self._now_s = node, physics, joint_names, now_s
        node.create_subscription(Float64MultiArray, "position_controller/commands", self._on_positions, 1)
        node.create_subscription(JointState, "joint_commands", self._on_named, NAMED_DEPTH)
        node.create_subscription(JointTrajectoryMessage, "joint_trajectory", self._on_trajectory, 1)
        self.action = TrajectoryAction(node, physics, now_s)

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
