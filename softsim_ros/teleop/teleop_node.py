"""ROS node `teleop`: keys in, joint commands and service calls out, the robot's state for the display."""

from __future__ import annotations

import math
import sys
import time
from array import array
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from rcl_interfaces.msg import Log
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import SetBool, Trigger

from softsim_core.scene import RobotDescription, load_scene
from softsim_core.scene.control import Action
from softsim_node.help import Program
from softsim_node.parameters import LiveParameters
from softsim_node.process import run_node
from softsim_ros.runtime import ClosableNode
from softsim_ros.teleop.bridge_link import BridgeLink
from softsim_ros.teleop.commands import (
    CallAction,
    Effect,
    PublishCommand,
    press,
    unknown_keys,
)
from softsim_ros.teleop.decoder import KeyPress
from softsim_ros.teleop.display import View
from softsim_ros.teleop.goal import PublishGoal
from softsim_ros.teleop.held_output import HeldOutput
from softsim_ros.teleop.inverse_link import InverseLink
from softsim_ros.teleop.loop import ready_callbacks, run_teleop
from softsim_ros.teleop.parameters import TeleopSettings, requested_robot
from softsim_ros.teleop.services import AsyncService
from softsim_ros.teleop.simulator_link import SimulatorLink
from softsim_ros.teleop.state import (
    STALE_AFTER_S,
    BridgeState,
    TeleopState,
    with_command,
    with_heard_command,
    with_inverse,
    with_measurement,
)
from softsim_ros.teleop.terminal import RawTerminal
from softsim_ros.teleop.tilt import PublishTilt
from softsim_ros.teleop.tilt_link import TiltLink

HOLD_INTERVAL_S = 0.2
"""On a robot without simulator the newest command is repeated after this long, in [s]."""
_NEWEST_ONLY = QoSProfile(depth=1)  # reliable, volatile


class Teleop(ClosableNode):
    """Thin: parameters, topics and services; what a key does is decided in `commands`.

    Topics (relative to the robot's namespace): `position_controller/commands` out, and in again to see the
    commands of others; `joint_states` in, or, on a robot without simulator, `applied_joint_states` of the
    bridge, and then the newest command is repeated so that the bridge does not rest; warnings of the robot's
    nodes from `/rosout` in; `keys` out, for the scene's own functions. Services called: `simulator/start`,
    `simulator/reset`, `simulator/pause`, `inverse_controller/enable`, and the lifecycle services of
    `servo_bridge`. While inverse control is on, `effector_goal` out instead of commands; `effector_pose` in.
    While the closed loop is on as well, `tilt_reference` out instead of goals.

    Args:
        robot: Joints, limits, poses and keys.
        name: Name of the node.
        **node_options: Passed on to rclpy's Node; without a namespace there, the robot's name is used (a
            remapping on the command line wins over both).
    """

    def __init__(self, robot: RobotDescription, name: str = "teleop", **node_options: Any) -> None:
        super().__init__(name, **{"namespace": robot.name, **node_options})
        self._live = LiveParameters(self, TeleopSettings(robot=robot.name))
        self.robot = robot
        self.state = TeleopState(message=unknown_keys(robot) or "")
        self.quit_requested = False
        self._joint_order: tuple[tuple[str, ...], list[int] | None] = ((), None)
        self._commands = self.create_publisher(
            Float64MultiArray, "position_controller/commands", _NEWEST_ONLY
        )
        self.create_subscription(
            Float64MultiArray, "position_controller/commands", self._on_command, _NEWEST_ONLY
        )
        self._keys = self.create_publisher(String, "keys", 10)
        self.create_subscription(JointState, "joint_states", self._on_joint_states, _NEWEST_ONLY)
        self.create_subscription(JointState, "applied_joint_states", self._on_applied, _NEWEST_ONLY)
        self.create_subscription(
            Float64MultiArray, "emulated_board/pulse_widths", self._on_pulses, _NEWEST_ONLY
        )
        self._joint_states_at = -math.inf
        self._held_at = -math.inf
        self.create_subscription(Log, "/rosout", self._on_log, 10)
        self._start = AsyncService(self, Trigger, "simulator/start")
        self._reset = AsyncService(self, Trigger, "simulator/reset")
        self._pause = AsyncService(self, SetBool, "simulator/pause")
        self._inverse = InverseLink(self)
        self._tilt = TiltLink(self)
        self._bridge = BridgeLink(self, self._on_bridge, self.set_status)
        self._simulator = SimulatorLink(self, self._on_simulator, self._on_enforced)

    def view(self, now: float) -> View:
        """What the display shows at `now`, steady clock in [s]."""
        self._follow(now)
        return View(self.robot, self.state, now, self.get_namespace())

    def _follow(self, now: float) -> None:
        self.state = self._tilt.follow(self._inverse.follow(self.state, now), now)

    def set_status(self, message: str) -> None:
        """Show one sentence."""
        self.state = replace(self.state, message=message)

    def handle_key(self, key: KeyPress, now: float) -> None:
        """Do what a key asks for, without waiting for anything; `now` is a steady clock in [s]."""
        self._follow(now)
        self._keys.publish(String(data=key.name))
        interval, step = self._live.values.repeat_interval, self._live.values.goal_step
        self.state, effects = press(self.state, self.robot, key, now, interval, step)
        self.carry_out(effects, now)

    def tick(self, now: float) -> None:
        """Housekeeping, several times per second: the bridge's state, unanswered calls, a held command."""
        self._hold(now)
        self._bridge.poll(now)
        self._simulator.poll(now)
        for service in (self._start, self._reset, self._pause, self._inverse.service):
            service.expire(now)

    def carry_out(self, effects: Sequence[Effect], now: float) -> None:
        """Do what was decided, without waiting for anything; `now` is a steady clock in [s]."""
        for effect in effects:
            self._carry_out(effect, now)

    def _carry_out(self, effect: Effect, now: float) -> None:
        if isinstance(effect, PublishCommand):
            self._commands.publish(Float64MultiArray(data=array("d", effect.values)))
        elif isinstance(effect, PublishGoal):
            self._inverse.publish(effect.goal)
        elif isinstance(effect, PublishTilt):
            self._tilt.publish(effect.reference)
        elif isinstance(effect, CallAction):
            self._call(effect.action, now)
        else:
            self.quit_requested = True

    def _call(self, action: Action, now: float) -> None:
        if action == "start":
            self._ask("simulator", self._start, Trigger.Request(), now, self._on_started)
        elif action == "reset" and self.state.inverse:  # else it would drive the joints back
            self._enable_inverse(False, now, then=lambda: self._call("reset", time.monotonic()))
        elif action == "reset":
            self._ask("simulator", self._reset, Trigger.Request(), now, self._on_reset)
        elif action == "pause":
            pause = not self.state.paused
            self._ask(
                "simulator", self._pause, SetBool.Request(data=pause), now, lambda: self._on_paused(pause)
            )
        elif action == "inverse":
            self._enable_inverse(not self.state.inverse, now)
        elif action == "send":
            self._bridge.toggle(now)

    def _enable_inverse(self, enable: bool, now: float, then: Callable[[], None] = lambda: None) -> None:
        def done() -> None:
            self._on_inverse(enable)
            then()

        request = SetBool.Request(data=enable)
        self._ask("inverse control", self._inverse.service, request, now, done)

    def _ask(self, who: str, service: AsyncService, request: Any, now: float, done: Any) -> None:
        """Call a service that answers success and a sentence; `done` is called on success."""

        def answered(response: Any) -> None:
            if response is None:
                self.set_status(f"{who}: no answer from {service.name}")
            elif not response.success:
                self.set_status(f"{who}: {response.message or 'refused without a reason'}")
            else:
                done()
                if response.message:
                    self.set_status(f"{who}: {response.message}")

        if service.is_busy:
            self.set_status(f"{who}: still busy with {service.name}")
        elif not service.is_there:
            self.set_status(f"{who} is not running (no service {self.resolve_service_name(service.name)})")
        else:
            service.call(request, now, answered)

    def _on_started(self) -> None:
        start = self.robot.start
        if start is not None and self.state.measured is not None:
            pose = self.robot.poses[start.pose]
            self.state = with_command(self.state, self.robot, tuple(pose), time.monotonic())
        self.set_status("start pose")

    def _on_reset(self) -> None:
        self.state = replace(self.state, commanded=None)
        self.set_status("simulation reset")

    def _on_paused(self, paused: bool) -> None:
        self.state = replace(self.state, simulator="paused" if paused else "running")
        self.set_status("simulation paused" if paused else "simulation goes on")

    def _on_inverse(self, enabled: bool) -> None:
        self.state = with_inverse(self.state, enabled)
        self._inverse.switched(time.monotonic())
        self.set_status(f"inverse control is {'on' if enabled else 'off'}")

    def _on_bridge(self, state: BridgeState) -> None:
        if state != self.state.bridge:
            self.state = replace(self.state, bridge=state)

    def _on_simulator(self, word: str, real_time_factor: float | None) -> None:
        self.state = replace(self.state, simulator=word, real_time_factor=real_time_factor)

    def _on_enforced(self, enforced: bool) -> None:
        if enforced != self.state.enforce_limits:
            self.state = replace(self.state, enforce_limits=enforced)

    def _on_joint_states(self, message: JointState) -> None:
        self._joint_states_at = time.monotonic()
        self._measure(message)

    def _on_applied(self, message: JointState) -> None:
        if self._is_bare(time.monotonic()):
            self._measure(message)

    def _is_bare(self, now: float) -> bool:
        """No simulator, and nobody measures joints: only what the bridge applied is known."""
        return now - self._joint_states_at > STALE_AFTER_S and not self._start.is_there

    def _hold(self, now: float) -> None:
        """On a bare robot, repeat our command while it is the newest: to the bridge silence is the end."""
        state = self.state
        own = state.commanded if state.owns_command and not state.inverse else None
        if self._is_bare(now) and state.bridge == "comm" and own is not None:
            if now - self._held_at >= HOLD_INTERVAL_S:
                self._held_at = now
                self._commands.publish(Float64MultiArray(data=array("d", own)))
        elif state.bridge != "comm" and self._is_bare(now):
            self.state = replace(state, commanded=None)  # a new start begins where the servos are

    def _measure(self, message: JointState) -> None:
        names = tuple(message.name)
        if names != self._joint_order[0]:
            self._joint_order = (names, self._order_of(names))
        order = self._joint_order[1]
        if order is None or len(message.position) != len(names):
            return
        positions = [message.position[index] for index in order]
        self.state = with_measurement(self.state, positions, time.monotonic())

    def _order_of(self, names: Sequence[str]) -> list[int] | None:
        missing = [joint for joint in self.robot.joint_names if joint not in names]
        if missing:
            found = ", ".join(names) or "it"
            self.set_status(f"joint_states of another robot: {', '.join(missing)} not in {found}")
            return None
        return [names.index(joint) for joint in self.robot.joint_names]

    def _on_command(self, message: Float64MultiArray) -> None:
        self.state = with_heard_command(self.state, self.robot, message.data, time.monotonic())

    def _on_pulses(self, message: Float64MultiArray) -> None:
        self.state = replace(self.state, pulses_us=tuple(message.data), pulses_at=time.monotonic())

    def _on_log(self, message: Log) -> None:
        """Show warnings and errors of the robot's other nodes, and whatever the scene's own code prints."""
        source, _, child = message.name.rpartition(".")
        by_scene = child == "scene"
        space, _, name = (source if by_scene else message.name).rpartition(".")
        if message.level < Log.WARN and not by_scene:
            return
        if "/" + space.replace(".", "/") == self.get_namespace().rstrip("/") and name != self.get_name():
            self.set_status(f"{child}: {' '.join(message.msg.split())}")


def drive(node: Teleop) -> None:
    """Keys and display in this terminal until a person or a signal ends it.

    SIGINT, SIGTERM and SIGHUP end its loop in order, see `softsim_node.ending`.

    Raises:
        NoTerminalError: this terminal cannot be used.
    """
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    try:
        with HeldOutput(), RawTerminal(signals=()) as terminal:
            run_teleop(node, terminal, lambda: ready_callbacks(executor))
    finally:
        executor.shutdown(timeout_sec=0)


PROGRAM = Program(
    name="teleop",
    about="Drives a robot from this terminal's keys.",
    settings=(TeleopSettings(),),
)


def main(args: Sequence[str] | None = None) -> int:
    """Run the teleop in this terminal; returns the exit code."""
    return run_node(PROGRAM, lambda _: Teleop(load_scene(requested_robot())), args, drive)


if __name__ == "__main__":
    sys.exit(main())
