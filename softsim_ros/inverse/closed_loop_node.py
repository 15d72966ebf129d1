"""The node `closed_loop`: measured tilts and their reference in, goals of the inverse controller out."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final

import numpy as np
from geometry_msgs.msg import PoseStamped, Vector3, Vector3Stamped
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from sensor_msgs.msg import Imu
from std_msgs.msg import Bool
from std_srvs.srv import SetBool

from servo_bridge.state_topics import StateTopics
from softsim_core import RobotDescription
from softsim_core.arrays import Array
from softsim_core.errors import CommandError
from softsim_core.inverse.closed_loop import ClosedLoopLog
from softsim_core.inverse.paths import MAZE_LIFT_M
from softsim_core.inverse.tilts import tilt_rotation, tilts_of
from softsim_core.mechanics.pose import quaternion_of, rotation_of
from softsim_node.help import Program
from softsim_node.parameters import LiveParameters
from softsim_node.process import run_node
from softsim_ros.frames import WORLD
from softsim_ros.inverse import answers
from softsim_ros.inverse.closed_loop_parameters import LoopSettings
from softsim_ros.inverse.goals import checked_pose
from softsim_ros.inverse.inverse_switch import InverseSwitch
from softsim_ros.inverse.path_follower_parameters import LEAVE
from softsim_ros.inverse.robot import check_frame, effector_rest, world_frames
from softsim_ros.inverse.tilt_loop import LoopStep, TiltLoop
from softsim_ros.inverse.tilt_messages import imu_tilts, pose_tilts, reference_tilts
from softsim_ros.messages import pose_stamped
from softsim_ros.messages.diagnostics import OK, WARN
from softsim_ros.qos import MEASURED
from softsim_ros.robot_node import FrameSettings, RobotNode

NODE_NAME: Final = "closed_loop"


class ClosedLoop(RobotNode):
    """Tilts the goal until the measured tilts are the wanted ones; made as RobotNode says.

    Raises:
        SoftSimError: the robot is not known, a parameter is not allowed, or the log cannot be written.
    """

    node_name = NODE_NAME
    _log: ClosedLoopLog | None = None

    def _begin(self, robot: RobotDescription) -> None:
        rest = effector_rest(robot)
        defaults = LoopSettings(robot=self.robot_parameter, height=float(rest[2] + MAZE_LIFT_M))
        self._live = LiveParameters(self, defaults, check=_check, apply=self._retune)
        start = self._live.values
        self._position = np.array([rest[0], rest[1], start.height])
        self._turn = 0.0
        self._loop = TiltLoop(start.gains, start.measure_timeout)
        self._source = start.measure
        self._enabled = False
        self._step: LoopStep | None = None
        self._said = ""
        self._log = ClosedLoopLog(Path(start.log_file).expanduser()) if start.log_file else None
        self._goals = self.create_publisher(PoseStamped, "effector_goal", 1)
        self.create_subscription(Vector3Stamped, "tilt_reference", self._on_tilts, 1)
        self.create_subscription(PoseStamped, "effector_reference", self._on_reference, 1)
        if self._source == "imu":
            self.create_subscription(Imu, "imu", self._on_imu, MEASURED)
        else:
            self.create_subscription(PoseStamped, "effector_pose", self._on_effector, MEASURED)
        self._task = start.task
        self._inverse = InverseSwitch(self, lambda _: None, self.get_logger().warning)
        self._follows = self._task == LEAVE
        self.create_service(SetBool, "~/enable", answers.switch(self.enable))
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0 / start.rate, self._tick, clock=steady)
        self.create_timer(1.0, self._report, clock=steady)
        self._state_topics = StateTopics(
            self,
            {
                "~/enabled": (Bool, lambda: Bool(data=self._enabled)),
                "~/reference": (Vector3, self._reference),
            },
        )
        if start.enabled:
            self.enable(True)
        self.get_logger().info(f"measures tilts on {self._source}; {'on' if self._enabled else 'off'}")

    def close(self) -> None:
        """Close the log, then destroy the node; a second call does nothing."""
        if self._log is not None:
            with suppress(OSError):
                self._log.close()
            self._log = None
        super().close()

    def enable(self, enabled: bool) -> str:
        """Begin anew (no integral, time 0), or give no goals any more; returns a sentence."""
        if enabled and not self._enabled:
            self._loop.begin(time.monotonic())
            self._follows = self._task == LEAVE
        self._enabled = enabled
        self._state_topics.refresh()
        waits = enabled and not self._loop.has_measure
        return f"waiting for {self._source}" if waits else "on" if enabled else "off: no goals are given"

    def _reference(self) -> Vector3:
        x, y = map(float, self._loop.reference)
        return Vector3(x=x, y=y)

    # --- messages -------------------------------------------------------------------------------------

    def _on_tilts(self, message: Vector3Stamped) -> None:
        try:
            if message.header.frame_id:
                check_frame("tilt reference", message.header.frame_id, self.frames)
            self._loop.reference = reference_tilts(message)
        except CommandError as error:
            self.get_logger().warning(str(error), throttle_duration_sec=1.0)

    def _on_reference(self, message: PoseStamped) -> None:
        try:
            pose = checked_pose(message, world_frames(self.frames), "reference")
        except CommandError as error:
            self.get_logger().warning(str(error), throttle_duration_sec=1.0)
            return
        tilts = tilts_of(rotation_of(pose.quaternion_xyzw))
        self._position, self._turn = pose.position, tilts.turn
        self._loop.reference = np.array([tilts.x, tilts.y])

    def _on_imu(self, message: Imu) -> None:
        try:
            self._take(imu_tilts(message))
        except CommandError as error:
            self._say(f"imu is not used, the old measure is kept: {error}")

    def _on_effector(self, message: PoseStamped) -> None:
        try:
            tilts = pose_tilts(message.pose.orientation)
            self._take(np.array([tilts.x, tilts.y]))
        except CommandError as error:
            self._say(f"effector_pose is not used, the old measure is kept: {error}")

    def _take(self, tilts: Array) -> None:
        self._loop.measured(tilts, time.monotonic())
        if self._said:
            self.get_logger().info(f"measuring on {self._source} again")
            self._said = ""

    def _say(self, sentence: str) -> None:
        """Warn of a trouble once; it ends with the next good measure."""
        if not self._said:
            self.get_logger().warning(sentence)
        self._said = sentence

    def _retune(self, _: frozenset[str], settings: LoopSettings) -> None:
        self._loop.controller.gains = settings.gains
        self._position[2] = settings.height
        self._loop.measure_timeout = settings.measure_timeout

    # --- time -----------------------------------------------------------------------------------------

    def _tick(self) -> None:
        if not self._enabled:
            return
        self._inverse.expire()
        if not self._follows and self._inverse.is_there:
            self._inverse.follow(self._task)
            self._follows = True
        step = self._loop.step(time.monotonic())
        if step is None:
            self._say(f"waiting: nothing was measured on {self._source} yet, so no goal is given")
            return
        if step.holds:
            self._say(f"holding: nothing was measured on {self._source} for {self._loop.measure_timeout:g} s")
        self._step = step
        orientation = quaternion_of(tilt_rotation(step.command[0], step.command[1], self._turn))
        stamp = self.get_clock().now().to_msg()
        self._goals.publish(pose_stamped(stamp, WORLD, self._position, orientation))
        if not step.holds:
            self._write(step)

    def _write(self, step: LoopStep) -> None:
        """A row of the log; its x axis is our y, and its z our x."""
        if self._log is None:
            return
        try:
            self._log.write(step.time, step.reference[::-1], step.command[::-1], step.measure[::-1])
        except OSError as error:
            self.get_logger().error(f"{self._log.file} is not written any more: {error.strerror}")
            self._log = None

    def _report(self) -> None:
        step = self._step
        if self._log is not None:
            with suppress(OSError):  # the next row says it
                self._log.flush()
        state = (
            "off" if not self._enabled else "waiting" if step is None else "holding" if step.holds else "on"
        )
        values: dict[str, object] = {"state": state, "measure": self._source}
        if step is not None:
            for name in ("reference", "command", "measure"):
                values[f"{name}_x_rad"], values[f"{name}_y_rad"] = map(float, getattr(step, name))
            values["saturated"] = self._loop.controller.is_saturated
            values["time_s"] = step.time
        level, sentence = (WARN, self._said) if self._enabled and self._said else (OK, state)
        self._publish_health(level, sentence, values)


def _check(_: frozenset[str], settings: LoopSettings) -> None:
    """Raise where the gains do not fit together."""
    _gains = settings.gains


PROGRAM = Program(
    name="closed_loop",
    about="Tilts the goal until the measured tilts are the wanted ones.",
    settings=(LoopSettings(), FrameSettings()),
)


def main(args: Sequence[str] | None = None) -> int:
    """Run the closed loop as a process; returns the exit code."""
    return run_node(PROGRAM, lambda _: ClosedLoop(), args)


if __name__ == "__main__":
    sys.exit(main())
