"""The node `policy`: reads a robot's topics and publishes the joint commands of a trained policy."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
from geometry_msgs.msg import PoseArray, PoseStamped
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Bool, Float64
from std_srvs.srv import SetBool

from softsim_core import RobotDescription
from softsim_core.base import Array, CommandError, ConfigError, PolicyError
from softsim_core.lab.learning import load_policy
from softsim_core.physics.mechanics import Pose, rotation_of
from softsim_node import (
    LATCHED,
    MEASURED,
    NEWEST_ONLY,
    Program,
    StateTopics,
    answering,
    declare,
    parameter,
    run_node,
    steady_timer,
)
from softsim_ros import FrameSettings, JointReader, JointStates, RobotNode, RobotSettings, StateListener
from softsim_ros.messages import OK, WARN
from softsim_ros.nodes.inverse import (
    CommandsOut,
    SimulatedRobot,
    check_frame,
    checked_pose,
)


@dataclass(frozen=True, kw_only=True)
class PolicyParameters(RobotSettings):
    """Values of the parameters."""

    policy: str = parameter("", "ONNX file of the policy", fixed=True)
    enabled: bool = parameter(False, "Switch it on as soon as each of its inputs has arrived", fixed=True)
    measure_timeout: float = parameter(
        0.2,
        "What is older is not used: the command stays what it was",
        unit="s",
        within=(0.01, 60.0),
        fixed=True,
    )


class LatestReadings:
    """Latest sensor values of one robot, each with its time of arrival; implements `Senses` for k = 1.

    Args:
        asks: Names of the values that the policy observes, see Senses.
        goal_size: Number of components of a goal.

    Attributes:
        has_goal: Whether the goal is known; True if the task has no goal.
    """

    joint_positions: Array
    joint_efforts: Array
    effector_position: Array
    effector_rotation: Array
    effector_rate: Array
    effector_force: Array
    thing_position: Array

    def __init__(self, asks: Sequence[str], goal_size: int) -> None:
        self._asks = asks
        self._at: dict[str, float] = {}
        self.commands = np.zeros((1, 0))
        self.goals = np.zeros((1, 0))
        self.has_goal = not goal_size

    def take(self, name: str, value: Array, now: float) -> bool:
        """Store a value that arrived at `now` in [s]. Return False if it is not finite and was ignored."""
        if not np.isfinite(value).all():
            return False
        setattr(self, name, value[None])
        self._at[name] = now
        return True

    def take_pose(self, pose: Pose, now: float) -> None:
        """Store the position and the rotation of the effector."""
        self.take("effector_position", pose.position, now)
        self.take("effector_rotation", rotation_of(pose.quaternion_xyzw), now)

    def aim(self, goal: Array) -> None:
        """Set the goal, shape (g,)."""
        self.goals, self.has_goal = goal[None], True

    def missing(self, now: float, timeout: float) -> list[str]:
        """Return the names of the values that did not arrive within `timeout` before `now`, both in [s]."""
        return [name for name in self._asks if not now - self._at.get(name, -np.inf) <= timeout]


NODE_NAME: Final = "policy"
SHIFTED_M: Final = 1e-3
"""Largest shift of the joint bases in [m]; beyond it the robot is not the one of the training environment."""

TOPIC_OF: Final = {
    "joint_positions": "joint_states",
    "joint_efforts": "joint_states (efforts)",
    "effector_position": "effector_pose",
    "effector_rotation": "effector_pose",
    "effector_rate": "imu",
    "effector_force": "imu",
    "thing_position": "bodies/poses",
}
"""Topic of each observed value, for messages to users."""


class PolicyNode(RobotNode):
    """Drives one robot by a policy; works with the simulator and with the real robot alike.

    Created as RobotNode describes. Observation and command use the code of the Gymnasium environment.

    Raises:
        SoftSimError: robot or policy are not known or do not fit, or a parameter is not allowed.
    """

    node_name = NODE_NAME

    def _begin(self, robot: RobotDescription) -> None:
        values = declare(self, PolicyParameters(robot=self.robot_parameter))
        if not values.policy:
            raise ConfigError(NODE_NAME, "parameter policy", "no file is named: give -p policy:=FILE.onnx")
        self._policy = load_policy(values.policy)
        self._thing = self._policy.check_robot(robot)
        self._robot_shift = self._policy.task.description().start_shift  # its episodes begin there
        task = self._policy.task
        self._latest = LatestReadings(task.asks, task.goal_size)
        self._timeout = values.measure_timeout
        self._requested, self._enabled, self._problem, self._said = values.enabled, False, "", ""
        self._sent = 0
        self._has_command = False
        self._other_robot = ""
        self._base_shift = self._robot_shift
        self._joint_reader = JointReader(robot.joints, self.refuse)
        self._commands = CommandsOut(self, "the policy", lambda: self._enabled, self.refuse)
        self._subscribe(task.asks, bool(task.goal_size))
        self._inverse = StateListener(self, "inverse_controller/enabled")
        self.create_service(SetBool, "~/enable", answering(self.enable))
        simulated = bool(self.get_parameter("use_sim_time").value)
        clock = self.get_clock() if simulated else Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0 / self._policy.rate, self._tick, clock=clock)
        steady_timer(self, 1.0, self._report)
        self._state_topics = StateTopics(self, {"policy/enabled": lambda: Bool(data=self._enabled)})
        self.get_logger().info(
            f"{self._policy.name} at {self._policy.rate:g} Hz for {robot.name}; "
            + ("on as soon as every message has come" if self._requested else f"call {NODE_NAME}/enable")
        )

    def _subscribe(self, asks: Sequence[str], has_goal: bool) -> None:
        JointStates(self, self._timeout, self._take_joints)
        self.create_subscription(Float64, "base_shift", self._on_base_shift, LATCHED)
        SimulatedRobot(self, self._on_other_robot, self.refuse)
        if "effector_position" in asks:
            self.create_subscription(PoseStamped, "effector_pose", self._on_effector, MEASURED)
        if "effector_rate" in asks:
            self.create_subscription(Imu, "imu", self._on_imu, MEASURED)
        if "thing_position" in asks:
            self.create_subscription(PoseArray, "bodies/poses", self._on_bodies, MEASURED)
        if has_goal:
            self.create_subscription(PoseStamped, "effector_goal", self._on_goal, NEWEST_ONLY)

    # --- services -------------------------------------------------------------------------------------

    def enable(self, enabled: bool) -> str:
        """Start driving the robot at the next tick, or release the command topic; return a message about it.

        Raises:
            CommandError: a value that the policy observes did not arrive recently, or another node drives the
                robot.
        """
        self._requested = False
        if not enabled:
            self._stop("")
            return "off: the command topic is free"
        if not self._enabled:
            if obstacle := self._obstacle():
                raise CommandError(f"not switched on: {obstacle}")
            self._begin_driving()
        waits = "" if self._latest.has_goal else "; the robot stays where it is until a goal comes"
        return f"on: {self._policy.name} at {self._policy.rate:g} Hz{waits}"

    def _begin_driving(self) -> None:
        self._latest.commands = self._latest.joint_positions.copy()
        self._has_command = False
        self._enabled, self._requested, self._problem = True, False, ""
        self._state_topics.refresh()

    def _stop(self, message: str) -> None:
        self._enabled, self._problem = False, message
        if message:
            self.get_logger().error(message)
        self._state_topics.refresh()

    def _obstacle(self) -> str:
        """Return why the policy may not drive now: `_another`, else missing measurements; empty if it may."""
        if another := self._another():
            return another
        if missing := self._latest.missing(time.monotonic(), self._timeout):
            topics = ", ".join(dict.fromkeys(TOPIC_OF[name] for name in missing))
            return f"nothing arrived within {self._timeout:g} s on {topics}"
        return ""

    def _another(self) -> str:
        """Return why the policy must not drive this robot, or not at present; an empty string if it may.

        It must not where the robot or its base shift differs from training, or while inverse control is on.
        """
        if self._other_robot:
            return self._other_robot
        if abs(self._base_shift - self._robot_shift) > SHIFTED_M:
            return (
                f"the joint bases are shifted by {1e3 * self._base_shift:g} mm, the policy has learned with "
                f"{1e3 * self._robot_shift:g} mm; play the start move (key A, simulator/start)"
            )
        if self._inverse.value:
            return "inverse control is on, and there is one writer at a time; disable it"
        return ""

    # --- messages -------------------------------------------------------------------------------------

    def _take_joints(self, message: JointState) -> None:
        now = time.monotonic()
        for name, read in (
            ("joint_positions", self._joint_reader.read),
            ("joint_efforts", self._joint_reader.efforts),
        ):
            found = read(message)
            if found is not None and not self._latest.take(name, found, now):
                self.refuse(f"joint states with {name} that are not finite are not used")

    def _on_effector(self, message: PoseStamped) -> None:
        pose = checked_pose(message, self.frames, "effector_pose")
        self._latest.take_pose(pose, time.monotonic())

    def _on_imu(self, message: Imu) -> None:
        rate, force, now = message.angular_velocity, message.linear_acceleration, time.monotonic()
        for name, value in (("effector_rate", rate), ("effector_force", force)):
            if not self._latest.take(name, np.array([value.x, value.y, value.z]), now):
                self.refuse("imu refused: it has a number that is not finite")

    def _on_bodies(self, message: PoseArray) -> None:
        check_frame("bodies/poses", message.header.frame_id, self.frames)
        if self._thing < len(message.poses):
            place = message.poses[self._thing].position
            self._latest.take("thing_position", np.array([place.x, place.y, place.z]), time.monotonic())

    def _on_goal(self, message: PoseStamped) -> None:
        self._latest.aim(checked_pose(message, self.frames, "goal").position)

    def _on_base_shift(self, message: Float64) -> None:
        if np.isfinite(message.data):
            self._base_shift = message.data

    def _on_other_robot(self, message: str) -> None:
        self._other_robot = message

    # --- time -----------------------------------------------------------------------------------------

    def _tick(self) -> None:
        if not (self._enabled or self._requested):
            return
        if self._enabled and (another := self._another()):
            self._stop(f"the policy is off: {another}; then call {NODE_NAME}/enable")
            return
        obstacle = self._obstacle()
        self._say(f"waiting: {obstacle}" if obstacle else "")
        if not obstacle:
            if not self._enabled:
                self._begin_driving()
            if not self._latest.has_goal:
                return
            try:
                self._latest.commands = self._policy.command(self._latest)
            except PolicyError as error:
                self._stop(f"the policy is off: {error}")
                return
            self._has_command = True
        if self._enabled and self._has_command:
            # without measurements the last command is repeated, so the servos stay
            self._commands.publish(self._latest.commands[0])
            self._sent += 1

    def _say(self, message: str) -> None:
        """Log a new obstacle as a warning, once; an empty message means that it is gone."""
        if message and not self._said:
            self.get_logger().warning(message)
        self._said = message

    def _report(self) -> None:
        state = "waiting" if self._said else "on" if self._enabled else "off"
        values: dict[str, object] = {
            "state": state,
            "task": self._policy.name,
            "rate_hz": self._policy.rate,
            "commands": self._sent,
            "foreign_commands": self._commands.foreign,
        }
        trouble = self._problem or self._said
        self._publish_health(WARN if trouble else OK, trouble or state, values)


PROGRAM = Program(
    name="policy",
    about="Drives a robot by a trained policy in an ONNX file.",
    settings=(PolicyParameters(), FrameSettings()),
    more="What it subscribes to besides joint states depends on the policy's task: effector_pose, "
    "effector_goal, imu, bodies/poses.",
)

main = partial(run_node, PROGRAM, lambda _: PolicyNode())
"""Run as a process with the words of its command line; return the exit code."""

if __name__ == "__main__":
    sys.exit(main())
