"""What the page commands: a teleop with, besides the keys, sliders, buttons, parameters, goal and pull."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

from geometry_msgs.msg import PoseStamped, WrenchStamped
from numpy.typing import NDArray
from rclpy.qos import QoSProfile
from sensor_msgs.msg import MultiDOFJointState
from std_srvs.srv import SetBool, Trigger

from softsim_core.arrays import Array
from softsim_core.scene.robot import RobotDescription
from softsim_ros.messages import base_target, header
from softsim_ros.teleop.commands import move_joint
from softsim_ros.teleop.decoder import KeyPress
from softsim_ros.teleop.goal import PublishGoal
from softsim_ros.teleop.services import AsyncService
from softsim_ros.teleop.state import EffectorPose
from softsim_ros.teleop.teleop_node import Teleop
from softsim_ros.viewer.parameters_link import ParametersLink
from softsim_ros.viewer.pull import REPEAT_PERIOD_S, Pull
from softsim_ros.viewer.surface import MM
from softsim_ros.viewer.tuning import Tunable

PULL_LIMIT_N: Final = 2.0
"""Largest force of the mouse in [N]."""

_NEWEST_ONLY: Final = QoSProfile(depth=1)


class Commander(Teleop):
    """A teleop without terminal or page: each method is something that a person does.

    Besides what a Teleop has: `effector_goal` in, `external_wrench` and `base_target` out; services
    `simulator/step`, `simulator/reload`, `servo_bridge/e_stop`, `servo_bridge/clear_e_stop` and those of the
    simulator's parameters.

    Args:
        robot: Joints, limits, poses and keys.
        name: Name of the node.
        on_values: Called with values of the simulator's parameters by name, in SI.
        **node_options: Passed on to rclpy's Node.
    """

    def __init__(
        self,
        robot: RobotDescription,
        name: str,
        on_values: Callable[[dict[str, Any]], None],
        **node_options: Any,
    ) -> None:
        super().__init__(robot, name, **node_options)
        self.goal: EffectorPose | None = None
        self.pull_stiffness = 30.0
        self.parameters = ParametersLink(self, on_values, self.set_status)
        self._step = AsyncService(self, Trigger, "simulator/step")
        self._reload = AsyncService(self, Trigger, "simulator/reload", 60.0)
        self._e_stop = AsyncService(self, Trigger, "servo_bridge/e_stop")
        self._clear = AsyncService(self, Trigger, "servo_bridge/clear_e_stop")
        self._bases = self.create_publisher(MultiDOFJointState, "base_target", _NEWEST_ONLY)
        self._wrenches = self.create_publisher(WrenchStamped, "external_wrench", _NEWEST_ONLY)
        self.create_subscription(PoseStamped, "effector_goal", self._on_goal, _NEWEST_ONLY)

    def tick(self, now: float) -> None:
        """Housekeeping: links, calls without an answer, the goal."""
        super().tick(now)
        self.state = self._inverse.follow(self.state, now)
        self.parameters.poll(now)
        for service in (self._step, self._reload, self._e_stop, self._clear):
            service.expire(now)
        if not self.state.inverse:
            self.goal = None

    @property
    def goal_error_mm(self) -> float:
        """How far the effector is from its goal in [mm]; 0 without one."""
        effector = self.state.effector
        if self.goal is None or effector is None:
            return 0.0
        return MM * math.dist(self.goal.position, effector.position)

    def _on_goal(self, message: PoseStamped) -> None:
        place, turn = message.pose.position, message.pose.orientation
        self.goal = EffectorPose((place.x, place.y, place.z), (turn.x, turn.y, turn.z, turn.w))

    # --- joints and keys ------------------------------------------------------------------------------

    def press_button(self, name: str) -> None:
        """A click on a key's button: it acts each time, as no key is held."""
        seen = {key: at for key, at in self.state.seen_at.items() if key != name}
        self.state = replace(self.state, seen_at=seen)
        self.handle_key(KeyPress(name), time.monotonic())

    def press_hotkey(self, name: str) -> None:
        """A key with Ctrl; one that is held down repeats, and is slowed down as in the teleop."""
        self.handle_key(KeyPress(name, ctrl=True), time.monotonic())

    def drive_joint(self, joint: str, position: float) -> None:
        """Ask a joint to a position in [rad] or [m]."""
        now = time.monotonic()
        self.state, effects = move_joint(self.state, self.robot, joint, position, now)
        self.carry_out(effects, now)

    # --- simulator ------------------------------------------------------------------------------------

    def toggle_pause(self) -> None:
        """Run or pause the simulation."""
        pause = self.state.simulator not in ("paused", "stopped")
        self._ask_pause(pause, lambda: self._on_paused(pause))

    def _ask_pause(self, pause: bool, done: Any) -> None:
        self._ask("simulator", self._pause, SetBool.Request(data=pause), time.monotonic(), done)

    def step_once(self) -> None:
        """One step; a running simulation is paused first."""
        if self.state.simulator in ("paused", "stopped"):
            self._ask("simulator", self._step, Trigger.Request(), time.monotonic(), lambda: None)
        else:
            self._ask_pause(True, self._step_when_paused)

    def _step_when_paused(self) -> None:
        self._on_paused(True)
        self.step_once()

    def reset(self) -> None:
        """Back to the start of the scene."""
        self._call("reset", time.monotonic())

    def reload(self) -> None:
        """Load the scene's files anew."""
        self._ask("simulator", self._reload, Trigger.Request(), time.monotonic(), lambda: None)

    def tune(self, tunable: Tunable, value: Any) -> None:
        """Set a parameter of the simulator."""
        self.parameters.set(tunable.name, tunable.si(value))

    def choose_scene(self, name: str) -> None:
        """Run another robot or scene in place of this one."""
        self.set_status(f"loading {name} ...")
        self.parameters.set("robot", name)

    # --- servo board ----------------------------------------------------------------------------------

    def toggle_sending(self) -> None:
        """Start or stop sending to the board."""
        self._call("send", time.monotonic())

    def e_stop(self) -> None:
        """Hold the servos still, latched."""
        self._ask("servo bridge", self._e_stop, Trigger.Request(), time.monotonic(), lambda: None)

    def clear_e_stop(self) -> None:
        """Give the servos free again."""
        self._ask("servo bridge", self._clear, Trigger.Request(), time.monotonic(), lambda: None)

    # --- mouse ----------------------------------------------------------------------------------------

    def drag_goal(self, goal: EffectorPose) -> None:
        """Give inverse control a goal; nothing while it is off."""
        if self.state.inverse:
            self.goal = goal
            self.state = replace(self.state, goal=goal)
            self.carry_out((PublishGoal(goal),), time.monotonic())

    def set_pull_stiffness(self, stiffness: float) -> None:
        """Stiffness in [N/m] of the spring between the body and the mouse."""
        self.pull_stiffness = stiffness

    def move_base(self, joint: str, position_mm: Array) -> None:
        """Have the base of a joint go to a position (3,) in [mm]."""
        stamp = self.get_clock().now().to_msg()
        self._bases.publish(base_target(stamp, joint, (position_mm / MM).tolist()))

    def send_pull(self, pull: Pull | None, points: NDArray[Any], now: float) -> None:
        """Send the force of a pull that is held, now and then.

        Args:
            pull: The pull; None: nothing is held.
            points: Vertices of the visible surface in [mm], shape (p, 3).
            now: Steady clock in [s].
        """
        if pull is None or now - pull.sent_at < REPEAT_PERIOD_S:
            return
        pull.sent_at = now
        force: Array = pull.force(points, self.pull_stiffness, PULL_LIMIT_N)
        message = WrenchStamped(header=header(self.get_clock().now().to_msg(), f"mesh_point/{pull.vertex}"))
        message.wrench.force.x, message.wrench.force.y, message.wrench.force.z = force.tolist()
        self._wrenches.publish(message)
