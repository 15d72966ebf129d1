"""Run inverse control in its own thread: one tick per model step on the steady clock."""

from __future__ import annotations

import math
import threading
import time
from array import array
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64MultiArray

from softsim_core.base import Array, CommandError, SoftSimError, listing
from softsim_core.control.inverse import InverseController, InverseReport
from softsim_core.physics.mechanics import Pose
from softsim_core.scene import InverseSettings, JointDescription
from softsim_node import NEWEST_ONLY, OwnerThread, in_thread
from softsim_ros.nodes.inverse.plant import SILENT_AFTER_S, Feedback, Plant, off_command
from softsim_ros.nodes.simulator import Pacer, RateGate, SpeedMeter

STUCK_AFTER_S: Final = 1.0
"""Time in [s] after which joints away from their command count as not following."""


class FollowingCheck:
    """Checks whether the joints of a robot under control follow their commands."""

    def __init__(self, joints: Sequence[JointDescription], now: float) -> None:
        self._joints = joints
        self._followed_at = now
        self._stuck = ""

    def trouble(self, plant: Plant, command: Array | None, now: float) -> str:
        """Return why the command must stay unchanged at `now`; an empty string while the robot follows.

        Args:
            plant: Latest messages of the robot.
            command: The newest command in [rad] or [m], shape (j,); None before the first.
            now: Steady clock in [s].
        """
        if plant.is_silent(now) or plant.joints is None:
            self._followed_at = now  # after the silence the joints get their time to follow
            return f"holding: no joint states for more than {SILENT_AFTER_S:g} s; is the robot running?"
        off = [] if command is None else off_command(self._joints, plant.joints, command)
        if not off:
            self._followed_at, self._stuck = now, ""
        elif self._stuck or now - self._followed_at > STUCK_AFTER_S:
            self._stuck = f"holding: {listing(off)} not following the command; is the robot stopped?"
        return self._stuck


def has_moved(shift: float, plant: Plant) -> bool:
    """Return whether the joint bases have left the `shift` [m] with which the model was started."""
    return plant.base_shift is not None and not math.isclose(plant.base_shift, shift, abs_tol=1e-6)


TOPIC: Final = "position_controller/commands"
REMEMBERED: Final = 256
"""Number of own commands that are remembered until they return on the topic; a few seconds of them."""


class CommandsOut:
    """Publishes commands and detects commands of other publishers.

    Args:
        writer: Name of the controller in messages.
        refuse: Called in the node's executor with a message for every foreign command while it is on.

    Attributes:
        foreign: Number of foreign commands.
    """

    def __init__(
        self, node: Node, writer: str, is_on: Callable[[], bool], refuse: Callable[[str], None]
    ) -> None:
        self._writer, self._is_on, self._refuse = writer, is_on, refuse
        self.foreign = 0
        self._own: deque[bytes] = deque(maxlen=REMEMBERED)
        self._publisher = node.create_publisher(Float64MultiArray, TOPIC, NEWEST_ONLY)
        all_of_them = QoSProfile(depth=REMEMBERED)  # own ones return and must not displace others
        node.create_subscription(Float64MultiArray, TOPIC, self._on_command, all_of_them, raw=True)

    def publish(self, command: Array) -> None:
        """Publish one position per joint, in [rad] or [m], shape (j,)."""
        data = serialize_message(Float64MultiArray(data=array("d", command)))
        if not self._own or self._own[-1] != data:
            self._own.append(data)
        self._publisher.publish(data)

    def _on_command(self, data: bytes) -> None:
        if data not in tuple(self._own) and self._is_on():
            self.foreign += 1
            self._refuse(
                f"another program writes {TOPIC} while {self._writer} is on: one writer at a time; stop "
                f"it, or disable {self._writer}"
            )


Mode: TypeAlias = Literal["off", "on", "holding"]

DISABLED = "goal ignored: inverse control is off; call ~/enable first"


@dataclass(frozen=True)
class ControlStatus:
    """Recent state of the thread.

    Attributes:
        mode: "off", "on", or "holding" the command because the robot does not follow.
        message: Message for the user; empty if there is none.
        fault: Whether control switched itself off.
        report: Report of the newest tick since it was enabled.
        measured: Whether a measured pose corrected the model in that tick.
        rate: Ticks per second, over about the last second.
        stages_ms: Mean stage times over that second in [ms].
        late_s: Total wall time in [s] given up because ticks took too long.
    """

    mode: Mode = "off"
    message: str = ""
    fault: bool = False
    report: InverseReport | None = None
    measured: bool = False
    rate: float = 0.0
    stages_ms: tuple[tuple[str, float], ...] = ()
    late_s: float = 0.0


class ControlThread(OwnerThread):
    """Thread that owns an inverse controller, which is off at first; other threads send it requests.

    Args:
        joints: Joints of the robot, in command order.
        dt: Time from tick to tick in [s].
        publish: Called in the thread with every command, shape (j,), and with the model's pose.
        warn: Called in the thread with a message when the robot stops following, and when it follows again.
        ended: Called in the thread with a message when control switches itself off.
    """

    def __init__(
        self,
        controller: InverseController,
        joints: Sequence[JointDescription],
        dt: float,
        publish: Callable[[Array, Pose], None],
        warn: Callable[[str], None],
        ended: Callable[[str], None],
    ) -> None:
        self._controller, self._joints, self._dt = controller, joints, dt
        self._publish, self._warn, self._ended = publish, warn, ended
        self.plant = Plant()
        self.feedback: Feedback = "none"
        self.settings = controller.settings
        self._goal: Pose | None = None
        self._goal_lock = threading.Lock()
        super().__init__("inverse control", "inverse control", "one tick")
        self._pacer, self._gate = Pacer(), RateGate(1.0)
        self._meter = SpeedMeter(dt, time.monotonic())
        self._mode: Mode = "off"
        self._foreign = ""
        self._base_shift = 0.0
        self._following = FollowingCheck(joints, 0.0)
        self._command: Array | None = None
        self._rate = 0.0
        self._stages_ms: tuple[tuple[str, float], ...] = ()
        self._report: InverseReport | None = None
        self.status = ControlStatus()

    # --- from any thread ------------------------------------------------------------------------------

    def set_goal(self, goal: Pose) -> None:
        """Set the goal for the next tick; it replaces an earlier one.

        Raises:
            CommandError: control is off.
        """
        if self._mode == "off":
            raise CommandError(DISABLED)
        with self._goal_lock:
            self._goal = goal

    @in_thread
    def enable(self, base_shift: float) -> None:
        """Start control from the present joint positions; the goal is the effector's pose at that time.

        Args:
            base_shift: Shift of the joint bases in [m], used if the robot does not publish it.

        Raises:
            CommandError: no joint states are known, or the robot is not the model's.
            SoftSimError: the model cannot be brought there.
        """
        if self._mode != "off":
            return
        if self._foreign:
            raise CommandError(f"inverse control stays off: {self._foreign}")
        now, plant = time.monotonic(), self.plant
        if plant.joints is None or plant.is_silent(now):
            what = "yet" if plant.joints is None else f"for {now - plant.joints_at:.0f} s"
            raise CommandError(
                f"not enabled: no joint states received {what}; start the simulator, or on a bare robot "
                "the servo bridge (it must be sending)"
            )
        self._base_shift = base_shift if plant.base_shift is None else plant.base_shift
        self._controller.start(plant.joints, self._base_shift)
        with self._goal_lock:
            self._goal = None
        self._command = self._report = None
        self._following = FollowingCheck(self._joints, time.monotonic())
        self._pacer.start()
        self._meter.take(time.monotonic())
        self._mode = "on"
        self._show()

    @in_thread
    def tune(self, settings: InverseSettings) -> None:
        """Set other weights, gains and tolerances; limits stay as they were at the start."""
        self._controller.settings = self.settings = settings

    @in_thread
    def set_foreign(self, message: str) -> None:
        """Switch off while the robot differs from the model as `message` says; empty: it does not."""
        self._foreign = message
        if message and self._mode != "off":
            self._end(f"inverse control is off: {message}")

    @in_thread
    def disable(self) -> None:
        """Stop control; nothing is published afterwards."""
        self._stop("")

    # --- in the thread --------------------------------------------------------------------------------

    def _run(self) -> None:
        delay: float | None = None
        while self.serve(delay, lambda: self._mode):
            if self._mode == "off":
                delay = None
                continue
            delay = self._pacer.wait_s(time.monotonic(), self._dt) if self._try_tick() else None

    def _try_tick(self) -> bool:
        """Run a tick; return False if control switched off."""
        try:
            self._tick()
        except SoftSimError as error:
            self._fail(str(error))
        except Exception as error:  # whatever it is, the node must keep running and the topic be free
            self._fail(f"{type(error).__name__}: {error}")
        return self._mode != "off"

    def _tick(self) -> None:
        now, plant = time.monotonic(), self.plant
        if has_moved(self._base_shift, plant):
            self._fail("the robot was reset, or its start animation played: its bases have moved")
            return
        trouble = self._following.trouble(plant, self._command, now)
        if bool(trouble) != (self._mode == "holding"):
            self._mode = "holding" if trouble else "on"
            self._warn(trouble or "the robot follows again: inverse control continues")
        model_pose = None if self._report is None else self._report.model_pose
        measured = plant.measured_pose(self.feedback, model_pose, now)
        if not trouble:
            with self._goal_lock:
                goal, self._goal = self._goal, None
            if goal is not None:
                self._controller.set_goal(goal)
            report = self._controller.tick(measured)
            self._report, self._command = report, np.asarray(report.command)
            self._meter.add_step({"qp": report.qp_ms, "tick": report.tick_ms})
        if self._report is not None and self._command is not None:
            self._publish(self._command, self._report.model_pose)
        self._show(trouble, measured is not None)

    def _fail(self, reason: str) -> None:
        self._end(f"inverse control is off: {reason}; enable it again to continue from there")

    def _end(self, message: str) -> None:
        self._stop(message)
        self._ended(message)

    def _stop(self, message: str) -> None:
        self._mode = "off"
        self._show(message)

    def _show(self, message: str = "", measured: bool = False) -> None:
        now = time.monotonic()
        if self._mode != "off" and self._gate.passes(now):
            speed = self._meter.take(now)
            self._rate, self._stages_ms = speed.steps_per_second, tuple(speed.stages_ms.items())
        report = self._report if self._mode != "off" else None
        self.status = ControlStatus(
            mode=self._mode,
            message=message or ("" if report is None else report.message),
            fault=self._mode == "off" and bool(message),
            report=report,
            measured=measured,
            rate=self._rate if self._mode != "off" else 0.0,
            stages_ms=self._stages_ms,
            late_s=self._pacer.late_s,
        )
