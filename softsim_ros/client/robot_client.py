"""`RobotClient`: one robot's topics and services without any user interface, on the executor of a node."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node

from softsim_core.scene.robot import RobotDescription
from softsim_ros.client.bridge import Bridge
from softsim_ros.client.closed_loop import ClosedLoop
from softsim_ros.client.inverse import Inverse
from softsim_ros.client.joints import Joints
from softsim_ros.client.known import Known, Watcher
from softsim_ros.client.reports import Reports
from softsim_ros.client.simulator import Simulator
from softsim_ros.client.state import RobotState

POLL_PERIOD_S: Final = 0.1


class RobotClient:
    """What one can see and do of the robot in a node's namespace; nothing here waits or blocks.

    Every action takes a last argument `done`, which is called once with its `Outcome`; every outcome and
    every change worth a sentence goes to `say`. Methods are called from the thread that spins the node, and
    so are `done`, `say` and watchers (`connect` sees to that for scripts).

    Args:
        node: The node whose executor delivers messages and answers; the client does not own it.
        robot: Joints, limits and poses.
        say: Called with sentences for the person.

    Attributes:
        node: That node, for topics of one's own.
        joints: Commands and trajectories within the limits.
        simulator: Start, pause, steps, reset, scenes, parameters, pulls.
        bridge: Sending to the servo board, e-stop.
        inverse: Inverse control and its goal.
        closed_loop: The closed loop's reference.
    """

    def __init__(
        self, node: Node, robot: RobotDescription, say: Callable[[str], None] = lambda _: None
    ) -> None:
        self.node = node
        self._known = known = Known(robot, say)
        self.inverse = Inverse(node, known)
        self.closed_loop = ClosedLoop(node, known)
        self.joints = Joints(node, known, lambda: self.simulator.is_there)
        self.simulator = Simulator(node, known, self.joints, self.inverse)
        self.bridge = Bridge(node, known)
        self._reports = Reports(node, known, self.inverse.take_sentence)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(POLL_PERIOD_S, self._poll, clock=steady)

    @property
    def state(self) -> RobotState:
        """Everything known of the robot now; never changed, only replaced."""
        return self._known.state

    @property
    def robot(self) -> RobotDescription:
        """Joints, limits and poses."""
        return self._known.robot

    def watch(self, watcher: Watcher) -> None:
        """Have `watcher` called with the state after every change, from the thread that spins the node."""
        self._known.watchers.append(watcher)

    def begin(self, robot: RobotDescription) -> None:
        """Follow another robot or scene in the same namespace."""
        self._known.robot = robot
        self.joints.forget()

    def _poll(self) -> None:
        """Housekeeping: unanswered calls, silent nodes, a held command."""
        now = time.monotonic()
        for part in (self.joints, self.simulator, self.bridge, self.inverse):
            part.poll(now)
