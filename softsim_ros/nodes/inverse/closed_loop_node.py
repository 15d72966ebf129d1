"""The node `closed_loop`: turns measured and reference tilts into goals of the inverse controller."""

from __future__ import annotations

import math
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from geometry_msgs.msg import PoseStamped, Quaternion, Vector3, Vector3Stamped
from sensor_msgs.msg import Imu
from std_msgs.msg import Bool
from std_srvs.srv import SetBool

from softsim_core import RobotDescription
from softsim_core.base import Array, CommandError
from softsim_core.control.inverse import (
    MAZE_LIFT_M,
    ClosedLoopLog,
    TiltController,
    TiltGains,
    Tilts,
    tilt_rotation,
    tilts_of,
)
from softsim_core.physics.mechanics import quaternion_of, rotation_of
from softsim_node import (
    MEASURED,
    WORLD,
    LiveParameters,
    Program,
    StateTopics,
    answering,
    parameter,
    run_node,
    steady_timer,
)
from softsim_ros import FrameSettings, RobotNode, RobotSettings
from softsim_ros.messages import OK, WARN, pose_stamped
from softsim_ros.nodes.inverse.inverse_switch import InverseSwitch
from softsim_ros.nodes.inverse.path_follower_node import LEAVE
from softsim_ros.nodes.inverse.plant import check_frame, checked_pose, effector_rest

MEASURES: Final = ("imu", "effector_pose")
TASKS: Final = ("height_tilt", "orientation", "pose", LEAVE)
"""Tasks of the inverse controller that turn the plate."""

_LAW: Final = TiltGains()


@dataclass(frozen=True, kw_only=True)
class LoopSettings(RobotSettings):
    """Values of the parameters; the default of `height` lies above the robot's effector at rest."""

    kp: float = parameter(_LAW.proportional, "Proportional gain", within=(0.0, 100.0))
    ki: float = parameter(_LAW.integral, "Integral gain", unit="1/s", within=(0.0, 1000.0))
    anti_windup: float = parameter(_LAW.anti_windup, "Anti-windup gain", unit="1/s", within=(0.0, 1000.0))
    saturation: float = parameter(_LAW.saturation, "Largest tilt of the goal", unit="rad", within=(1e-3, 1.5))
    height: float = parameter(0.0, "Height of the goal", unit="m", within=(-10.0, 10.0))
    rate: float = parameter(50.0, "Steps per second", unit="Hz", within=(1.0, 1000.0), fixed=True)
    measure_timeout: float = parameter(
        0.5, "An older measure holds the command", unit="s", within=(0.01, 60.0)
    )
    measure: str = parameter(MEASURES[0], "Topic of the measured orientation", choices=MEASURES, fixed=True)
    task: str = parameter(
        TASKS[0], "What the inverse controller follows from the start on", choices=TASKS, fixed=True
    )
    log_file: str = parameter(
        "", "File for a row of comma separated values per step; empty: none", fixed=True
    )
    enabled: bool = parameter(False, "Switch the loop on at the start", fixed=True)

    @property
    def gains(self) -> TiltGains:
        """Gains of the control law.

        Raises:
            SoftSimError: they do not fit together.
        """
        return TiltGains(
            proportional=self.kp,
            integral=self.ki,
            anti_windup=self.anti_windup,
            saturation=self.saturation,
        )


UNIT_WITHIN = 0.1
"""Largest deviation of an orientation quaternion's norm from 1."""


def rotation(message: Quaternion) -> Array:
    """Return the rotation matrix (3, 3) of a quaternion message.

    Raises:
        CommandError: not finite, or its length is not 1.
    """
    quaternion = np.array([message.x, message.y, message.z, message.w])
    length = float(np.linalg.norm(quaternion))
    if not abs(length - 1.0) <= UNIT_WITHIN:  # also catches NaN and infinity
        raise CommandError(f"orientation {quaternion.tolist()} is no unit quaternion (x, y, z, w)")
    return rotation_of(quaternion / length)


def pose_tilts(message: Quaternion) -> Tilts:
    """Return tilts and turn of an orientation in the world.

    Raises:
        CommandError: no unit quaternion.
    """
    return tilts_of(rotation(message))


def imu_tilts(message: Imu) -> Array:
    """Return the tilts about x and y in [rad] of an IMU on the plate relative to gravity, shape (2,).

    The heading of its orientation is not used, so the IMU needs no magnetometer.

    Raises:
        CommandError: it has no orientation (first covariance -1), or no unit quaternion.
    """
    if message.orientation_covariance[0] == -1.0:
        raise CommandError("the message has no orientation (orientation_covariance[0] is -1)")
    up = rotation(message.orientation)[2]  # the world's z in the frame of the sensor
    return np.array([math.asin(min(max(up[1], -1.0), 1.0)), math.atan2(-up[0], up[2])])


class LoopStep(NamedTuple):
    """One step of the loop: tilts about x and y in [rad], shape (2,), and time in [s] since its start.

    If `holds` is true, the control law has not run: the command is the previous one, and its time does not
    count.
    """

    time: float
    reference: Array
    command: Array
    measure: Array
    holds: bool


class TiltLoop:
    """Runs the controller whenever `step` is called.

    Args:
        measure_timeout: Age in [s] of a measurement beyond which the command stays unchanged.
    """

    def __init__(self, gains: TiltGains, measure_timeout: float) -> None:
        self.controller = TiltController(gains)
        self.measure_timeout = measure_timeout
        self.reference = np.zeros(2)
        self._measure = np.zeros(2)
        self._measured_at = -math.inf
        self.begin(0.0)

    @property
    def has_measure(self) -> bool:
        """Whether any measurement has arrived."""
        return math.isfinite(self._measured_at)

    def begin(self, now: float) -> None:
        """Reset integral, command and time; `now` is a steady clock in [s]."""
        self.controller.reset()
        self._time = 0.0
        self._origin = self._last = now

    def store_measurement(self, tilts: Array, now: float) -> None:
        """Store a measurement: tilts about x and y in [rad], shape (2,), finite."""
        self._measure, self._measured_at = tilts.copy(), now

    def step(self, now: float) -> LoopStep | None:
        """Run one step at `now`; return None before the first measurement."""
        if not self.has_measure:
            self._origin = self._last = now
            return None
        holds = now - self._measured_at > self.measure_timeout
        if holds:
            self._origin += now - self._last
        else:
            time = now - self._origin
            # The difference of the logged times, so that the log reproduces the commands to the last bit.
            self.controller.update(self.reference, self._measure, max(time - self._time, 0.0))
            self._time = max(time, self._time)
        self._last = now
        command = self.controller.command
        return LoopStep(self._time, self.reference.copy(), command, self._measure.copy(), holds)


NODE_NAME: Final = "closed_loop"


class ClosedLoop(RobotNode):
    """Tilts the goal until the measured tilts equal the reference; created as RobotNode describes.

    Raises:
        SoftSimError: the robot is not known, a parameter is not allowed, or the log cannot be written.
    """

    node_name = NODE_NAME
    _log: ClosedLoopLog | None = None

    def _begin(self, robot: RobotDescription) -> None:
        rest = effector_rest(robot)
        defaults = LoopSettings(robot=self.robot_parameter, height=float(rest[2] + MAZE_LIFT_M))
        self._live = LiveParameters(
            self, defaults, check=lambda _, settings: settings.gains, apply=self._retune
        )
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
        self.create_service(SetBool, "~/enable", answering(self.enable))
        steady_timer(self, 1.0 / start.rate, self._tick)
        steady_timer(self, 1.0, self._report)
        self._state_topics = StateTopics(
            self,
            {
                "closed_loop/enabled": lambda: Bool(data=self._enabled),
                "closed_loop/reference": lambda: Vector3(
                    x=float(self._loop.reference[0]), y=float(self._loop.reference[1])
                ),
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
        """Start the loop (integral and time are 0), or stop sending goals; return a message."""
        if enabled and not self._enabled:
            self._loop.begin(time.monotonic())
            self._follows = self._task == LEAVE
        self._enabled = enabled
        self._state_topics.refresh()
        waits = enabled and not self._loop.has_measure
        return f"waiting for {self._source}" if waits else "on" if enabled else "off: no goals are given"

    # --- messages -------------------------------------------------------------------------------------

    def _on_tilts(self, message: Vector3Stamped) -> None:
        if message.header.frame_id:
            check_frame("tilt reference", message.header.frame_id, self.frames)
        tilts = np.array([message.vector.x, message.vector.y])
        if not np.isfinite(tilts).all():
            raise CommandError(
                f"tilt reference refused: {tilts.tolist()} rad is not finite; nothing was changed"
            )
        self._loop.reference = tilts

    def _on_reference(self, message: PoseStamped) -> None:
        pose = checked_pose(message, self.frames, "reference")
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
        self._loop.store_measurement(tilts, time.monotonic())
        if self._said:
            self.get_logger().info(f"measuring on {self._source} again")
            self._said = ""

    def _say(self, message: str) -> None:
        """Log a problem as a warning, once; the next good measurement ends it."""
        if not self._said:
            self.get_logger().warning(message)
        self._said = message

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
        if step.holds or self._log is None:
            return
        try:  # in the log, x is this node's y axis, and z its x axis
            self._log.write(step.time, step.reference[::-1], step.command[::-1], step.measure[::-1])
        except OSError as error:
            self.get_logger().error(f"{self._log.file} is not written any more: {error.strerror}")
            self._log = None

    def _report(self) -> None:
        step = self._step
        if self._log is not None:
            with suppress(OSError):  # the next row reports it
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
        level, message = (WARN, self._said) if self._enabled and self._said else (OK, state)
        self._publish_health(level, message, values)


PROGRAM = Program(
    name="closed_loop",
    about="Tilts the goal until the measured tilts are the wanted ones.",
    settings=(LoopSettings(), FrameSettings()),
)

main = partial(run_node, PROGRAM, lambda _: ClosedLoop())
"""Run as a process with the words of its command line; return the exit code."""

if __name__ == "__main__":
    sys.exit(main())
