"""Inverse control across processes: goals on a topic, commands to a real simulator, failures."""

from __future__ import annotations

import math
import os
import signal
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from waiting import BUILD_S

pytest.importorskip("rclpy")
pytest.importorskip("daqp")
pytestmark = [pytest.mark.ros, pytest.mark.slow]

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from diagnostics import diagnostic_values  # noqa: E402
from geometry_msgs.msg import PoseStamped  # noqa: E402
from rclpy.context import Context  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import Float64MultiArray  # noqa: E402
from std_srvs.srv import SetBool  # noqa: E402

from softsim_ros import SpinThread, StateListener  # noqa: E402
from softsim_ros.nodes.inverse import inverse_node  # noqa: E402

CONTROLLER = "softsim_ros.nodes.inverse.inverse_node"
NAME = "tripod/inverse_controller"
SPEED = 3.5  # rad/s, of the Tripod's servos
DT = 0.01


class Control:
    """An inverse controller in a process of its own beside a simulated Tripod."""

    def __init__(self, process: Any, tripod: Any, spin_until: Callable[..., bool]) -> None:
        self.process, self.tripod, self.client, self.spin_until = process, tripod, tripod.client, spin_until
        self.poses = self.client.collect(PoseStamped, "effector_pose", 1)
        self.states = self.client.collect(JointState, "joint_states", 1)
        self.commands = self.client.collect(Float64MultiArray, "position_controller/commands")
        self.reports = self.client.collect(DiagnosticArray, "/diagnostics")
        self.enabled = StateListener(self.client.node, "inverse_controller/enabled")

    def enable(self, enabled: bool = True) -> tuple[bool, str]:
        answer = self.client.call(SetBool, "inverse_controller/enable", SetBool.Request(data=enabled))
        return answer.success, answer.message

    def goal(self, x: float, y: float, z: float, frame: str = "world") -> None:
        message = PoseStamped()
        message.header.frame_id = frame
        place = message.pose.position
        place.x, place.y, place.z = x, y, z
        message.pose.orientation.w = 1.0
        self.client.publish("effector_goal", message)

    def is_refused(self, sentence: str, *goal: Any) -> bool:
        """Give a goal until a sentence refuses it; another warning may throttle the first."""

        def says() -> bool:
            self.goal(*goal)
            return bool(self.process.says(sentence, 1.5))

        return bool(self.spin_until(says))

    @property
    def effector(self) -> np.ndarray:
        place = self.poses[-1].pose.position
        return np.array([place.x, place.y, place.z])

    def reaches(self, goal: np.ndarray, within: float = 0.2e-3) -> bool:
        return self.spin_until(lambda: np.linalg.norm(self.effector - goal) < within)

    def report(self) -> tuple[str, dict[str, str]]:
        """Sentence and values of the newest diagnostics."""
        for message in reversed(self.reports):
            for status in message.status:
                if status.name == NAME:
                    return status.message, diagnostic_values(message, NAME)
        return "", {}

    def said(self, text: str) -> int:
        """How many of the diagnostics kept say so."""
        own = [status for each in self.reports for status in each.status if status.name == NAME]
        return sum(text in status.message for status in own)

    def says(self, text: str) -> bool:
        return self.spin_until(lambda: text in self.report()[0])

    def start_pose(self) -> None:
        """Key A, and wait until it is reached and at rest."""
        assert self.tripod.trigger("start")[0]
        assert self.spin_until(lambda: self.states and self.states[-1].position[0] < -1.49)
        assert self.spin_until(lambda: self.poses and np.abs(self.states[-1].velocity).max() < 1e-9)

    def hears_the_joints(self) -> bool:
        """Wait until it can be enabled, and leave it off."""
        return self.spin_until(lambda: self.enable()[0]) and self.enable(False)[0]

    def is_quiet(self) -> bool:
        """Whether no command comes for fifty ticks of the simulator, once those on their way have come."""
        ticks = [len(self.states)]

        def is_past() -> bool:
            if self.commands:
                self.commands.clear()
                ticks.append(len(self.states))
            return len(self.states) > ticks[-1] + 20

        assert self.spin_until(is_past)
        seen = len(self.states)
        return self.spin_until(lambda: len(self.states) > seen + 50) and not self.commands

    def rests(self, count: int) -> bool:
        """Whether the newest commands, so many, hardly differ."""
        return len(self.commands) > count and self.largest_step(count) < 1e-3

    def stands(self, count: int) -> bool:
        """Whether the newest commands, so many, are one and the same."""
        return len(self.commands) > count and self.largest_step(count) == 0.0

    def largest_step(self, count: int = 0) -> float:
        """Largest change of a joint from command to command (of the newest `count`), in [rad]."""
        sent = np.array([message.data for message in self.commands[-count:]])
        return float(np.abs(np.diff(sent, axis=0)).max())


@pytest.fixture(scope="module")
def controller(start_process: Callable[..., Any], running_tripod: Any) -> Any:
    process = start_process(CONTROLLER)
    assert process.says("ready to control", BUILD_S), process.output
    return process


@pytest.fixture
def control(controller: Any, tripod: Any, spin_until: Callable[..., bool]) -> Iterator[Control]:
    """The controller, off, in front of a Tripod in its start pose."""
    each = Control(controller, tripod, spin_until)
    assert each.enable(False)[0]
    each.start_pose()
    assert each.hears_the_joints()
    yield each
    assert each.enable(False)[0]


def test_the_effector_comes_to_the_goal_and_stays(control: Control) -> None:
    assert control.is_quiet()
    before = control.effector
    assert control.enabled.value is False
    assert control.enable()[0]
    assert control.spin_until(lambda: control.enabled.value is True)
    assert control.spin_until(lambda: len(control.commands) > 20)
    assert np.linalg.norm(control.effector - before) < 1e-3  # enabling moves nothing
    for shift in ((0.004, 0.0, 0.006), (-0.002, 0.006, 0.003)):
        goal = before + shift
        control.goal(*goal)
        assert control.reaches(goal), control.effector - goal
    assert control.spin_until(lambda: float(control.report()[1].get("residual_mm", "inf")) < 0.2)
    seen = len(control.states)
    assert control.spin_until(lambda: len(control.states) > seen + 100)
    assert np.linalg.norm(control.effector - goal) < 0.2e-3
    assert control.largest_step() <= SPEED * DT + 1e-9
    assert control.spin_until(lambda: float(control.report()[1]["ticks_per_second"]) > 0.0)


@pytest.mark.parametrize(
    ("goal", "sentence"),
    [
        ((math.nan, 0.0, 0.03, "world"), "is not finite"),
        ((0.0, 0.0, math.inf, "world"), "is not finite"),
        ((0.0, 0.0, 0.03, "camera"), "unknown frame_id 'camera'; allowed: world, tripod/base_link"),
    ],
)
def test_a_goal_that_makes_no_sense_is_refused(control: Control, goal: Any, sentence: str) -> None:
    assert control.enable()[0]
    assert control.spin_until(lambda: len(control.commands) > 10)
    before = control.effector
    assert control.is_refused(sentence, *goal), control.process.output
    seen = len(control.commands)
    assert control.spin_until(lambda: len(control.commands) > seen + 30)
    assert np.linalg.norm(control.effector - before) < 0.5e-3


def test_a_goal_ten_metres_away_keeps_the_limits_and_says_so(control: Control) -> None:
    assert control.enable()[0]
    control.goal(10.0, 0.0, 0.03)
    assert control.says("unreachable"), control.report()
    assert control.largest_step() <= SPEED * DT + 1e-9
    sent = np.array([message.data for message in control.commands])
    assert sent.min() >= -2.0225
    assert sent.max() <= -0.0255
    control.commands.clear()
    assert control.spin_until(lambda: control.rests(100))  # where it is nearest


def test_disabled_the_topic_is_free_and_goals_are_ignored(control: Control) -> None:
    assert control.enable()[0]
    assert control.spin_until(lambda: len(control.commands) > 10)
    assert control.enable(False) == (True, "off: the command topic is free")
    assert control.is_quiet()
    assert control.is_refused("goal ignored: inverse control is off", 0.0, 0.0, 0.03)
    assert control.is_quiet()
    control.tripod.command([-1.2, -1.2, -1.2])
    assert control.spin_until(lambda: abs(control.states[-1].position[0] + 1.2) < 1e-3)


def test_a_command_of_somebody_else_is_reported(control: Control) -> None:
    assert control.enable()[0]
    assert control.spin_until(lambda: len(control.commands) > 10)
    assert control.report()[1].get("foreign_commands", "0") == "0"
    control.tripod.command([-1.3, -1.4, -1.5])
    assert control.process.says("one writer at a time")
    assert control.spin_until(lambda: control.report()[1]["foreign_commands"] == "1")


def test_a_reset_ends_control(control: Control) -> None:
    assert control.enable()[0]
    assert control.spin_until(lambda: len(control.commands) > 10)
    assert control.tripod.trigger("reset")[0]
    assert control.process.says("its bases have moved; enable it again")
    assert control.is_quiet()
    assert control.hears_the_joints()  # from rest, with the bases where they are now


def test_another_robot_with_the_same_joints_switches_it_off(control: Control) -> None:
    assert control.enable()[0]
    assert control.spin_until(lambda: len(control.commands) > 10)
    try:
        looks = "{view: {stress: true}}"
        assert control.tripod.set_parameters(overrides=looks) == (True, "")
        control.start_pose()
        assert control.hears_the_joints()
        assert control.enable()[0]
        assert control.tripod.set_parameters(overrides="{gravity: [0.0, 0.0, -1.6]}") == (True, "")
        # whichever topic arrives first switches it off, the robot's or that of its bases, which are reset
        assert control.process.says("the simulator runs another robot now (tripod)")
        assert control.spin_until(lambda: control.enabled.value is False)
        assert control.is_quiet()
        success, sentence = control.enable()
        assert not success
        assert "stays off: the simulator runs another robot now" in sentence
    finally:
        assert control.tripod.set_parameters(overrides="") == (True, "")
    assert control.process.says("the simulator runs the robot of the model again")
    control.start_pose()
    assert control.hears_the_joints()


def test_a_paused_simulator_is_held_and_goes_on(control: Control) -> None:
    assert control.enable()[0]
    before, warned = control.effector, control.process.output.count("not following the command")
    assert control.tripod.pause(True)[0]
    assert control.spin_until(lambda: control.stands(20))
    goal = before + np.array([0.0, 0.0, 0.02])
    control.goal(*goal)
    assert control.says("holding: servo_0, servo_1, servo_2 not following the command")
    control.commands.clear()
    assert control.spin_until(lambda: control.stands(50))  # behind those that were on their way
    told = control.process.output.count("not following the command")
    assert told == warned + 1  # once, not at every tick
    assert control.tripod.pause(False)[0]
    assert control.reaches(goal)


def test_a_silent_simulator_is_held_and_goes_on(control: Control) -> None:
    assert control.enable()[0]
    assert control.spin_until(lambda: len(control.commands) > 10)
    goal = control.effector + np.array([0.0, 0.002, 0.004])
    os.kill(control.tripod.process.process.pid, signal.SIGSTOP)
    try:
        control.reports.clear()
        silent = "holding: no joint states for more than 1 s"
        assert control.spin_until(lambda: control.said(silent) > 2)  # one may tell of a pause of the machine
        control.goal(*goal)
        control.commands.clear()
        assert control.spin_until(lambda: len(control.commands) > 50)
        assert control.largest_step() == 0.0
    finally:
        os.kill(control.tripod.process.process.pid, signal.SIGCONT)
    assert control.reaches(goal)


def test_weights_change_at_run_time(control: Control) -> None:
    from rcl_interfaces.srv import SetParametersAtomically
    from rclpy.parameter import Parameter

    def put(name: str, value: Any) -> tuple[bool, str]:
        result = control.client.call(
            SetParametersAtomically,
            "inverse_controller/set_parameters_atomically",
            SetParametersAtomically.Request(parameters=[Parameter(name, value=value).to_parameter_msg()]),
        ).result
        return result.successful, result.reason

    assert control.enable()[0]
    try:
        assert put("position_weights", [0.0, 0.0, 1.0])[0]
        goal = control.effector + np.array(
            [0.5, 0.0, 0.003]
        )  # half a metre to the side, which nobody looks at now
        control.goal(*goal)
        assert control.spin_until(lambda: abs(control.effector[2] - goal[2]) < 0.2e-3)
        assert not put("gain", 2.0)[0]
        assert put("feedback", "telepathy") == (
            False,
            "parameter feedback = 'telepathy' is refused; allowed is one of: none, effector_pose, imu",
        )
    finally:
        assert put("position_weights", [1.0, 1.0, 1.0])[0]


def test_without_joint_states_it_is_not_enabled(ros_domain: int, client: Any) -> None:
    context = Context()
    context.init(args=["--ros-args", "--disable-rosout-logs"], domain_id=ros_domain)
    lonely = inverse_node.InverseControl("tripod", context=context, namespace="/lonely")
    try:
        with SpinThread([lonely], context):
            request = SetBool.Request(data=True)
            answer = client.call(SetBool, "/lonely/inverse_controller/enable", request)
    finally:
        lonely.close()
        context.try_shutdown()
    assert not answer.success
    assert "no joint states received yet; start the simulator" in answer.message


@pytest.mark.parametrize(
    ("setting", "sentence"),
    [
        ("robot:=nobody", "nobody"),
        ("task:=dance", "parameter task = 'dance' is refused; allowed is one of: position"),
    ],
)
def test_an_unknown_robot_or_task_is_one_sentence(
    ros_domain: int, capfd: pytest.CaptureFixture[str], setting: str, sentence: str
) -> None:
    assert inverse_node.main(["--ros-args", "-p", setting]) == 1
    written = capfd.readouterr().err
    assert sentence in written
    assert "Traceback" not in written


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_its_end_leaves_the_robot_where_it_is(
    start_process: Callable[..., Any],
    controller: Any,
    tripod: Any,
    spin_until: Callable[..., bool],
    number: signal.Signals,
) -> None:
    process = controller
    if process.process.poll() is not None:  # the case before this one has ended it
        process = start_process(CONTROLLER)
        assert process.says("ready to control", BUILD_S), process.output
    control = Control(process, tripod, spin_until)
    control.start_pose()
    assert control.hears_the_joints()
    assert control.enable()[0]
    goal = control.effector + np.array([0.0, 0.0, 0.005])
    control.goal(*goal)
    assert control.spin_until(lambda: control.rests(50))
    assert control.reaches(goal)
    assert process.end(number) == (0 if number == signal.SIGTERM else -signal.SIGKILL)
    assert control.is_quiet()
    assert np.linalg.norm(control.effector - goal) < 0.3e-3
    assert "Traceback" not in process.output
