"""The policy node over its topics: the environment's commands, and none on what is old or not finite."""

from __future__ import annotations

import math
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("onnxruntime")
pytest.importorskip("onnx")
pytestmark = pytest.mark.ros

from geometry_msgs.msg import PoseStamped  # noqa: E402
from policy_files import write_endless_policy, write_policy  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import Float64, Float64MultiArray  # noqa: E402
from std_srvs.srv import SetBool, Trigger  # noqa: E402
from waiting import BUILD_S, DEADLINE_S  # noqa: E402

from servo_bridge.driver import width_to_angle  # noqa: E402
from servo_bridge.emulator import (  # noqa: E402
    EmulatedBoardPty,
    VirtualBoard,
    why_missing,
)
from softsim_core import load_scene  # noqa: E402
from softsim_core.base import SoftSimError  # noqa: E402
from softsim_core.lab.learning import TASKS, Episodes, load_policy  # noqa: E402
from softsim_core.physics.mechanics import Pose  # noqa: E402
from softsim_node import LATCHED  # noqa: E402
from softsim_ros import SpinThread, StateListener  # noqa: E402
from softsim_ros.messages import pose_stamped, time_message  # noqa: E402
from softsim_ros.nodes.policy import (  # noqa: E402
    LatestReadings,
    PolicyNode,
)

TASK = "TripodReach-v0"
JOINTS = [-1.0, -1.1, -0.9]
PLACE, GOAL = [0.001, -0.002, 0.042], [0.003, 0.001, 0.045]
UPRIGHT = [0.0, 0.0, 0.0, 1.0]
SHIPPED = Path(__file__).parents[2] / "examples" / "learning" / "tripod_reach.onnx"


class Bench:
    """A policy before a robot that the test plays: fifty times a second it says where it is."""

    def __init__(self, node: PolicyNode, client: Any, speaks: bool) -> None:
        self.node, self.client = node, client
        self.commands: list[Any] = client.collect(Float64MultiArray, "position_controller/commands")
        self.enabled = StateListener(client.node, "policy/enabled")
        self._states = client.publisher(JointState, "joint_states")
        self._poses = client.publisher(PoseStamped, "effector_pose")
        self._shift = client.node.create_publisher(Float64, "base_shift", LATCHED)
        self.joints, self.place, self.speaks = list(JOINTS), list(PLACE), speaks
        self.spoken = 0
        self._timer = client.node.create_timer(0.02, self.speak)

    def speak(self) -> None:
        if self.speaks:
            names = ["servo_0", "servo_1", "servo_2"]
            self._states.publish(JointState(name=names, position=self.joints, effort=[0.0] * 3))
            self._poses.publish(pose_stamped(time_message(0.0), "world", self.place, UPRIGHT))
            self.spoken += 1

    def shift(self, metres: float) -> None:
        self._shift.publish(Float64(data=metres))

    def aim(self, goal: list[float]) -> None:
        self.client.publish("effector_goal", pose_stamped(time_message(0.0), "world", goal, UPRIGHT))

    def enable(self, on: bool = True) -> tuple[bool, str]:
        answer = self.client.call(SetBool, "policy/enable", SetBool.Request(data=on))
        return answer.success, answer.message

    def close(self) -> None:
        self._timer.cancel()
        for publisher in (self._states, self._poses, self._shift):
            self.client.node.destroy_publisher(publisher)


@pytest.fixture
def start_policy(ros_domain: int, client: Any, tmp_path: Path) -> Iterator[Callable[..., Bench]]:
    context = Context()
    context.init(args=[], domain_id=ros_domain)
    opened: list[tuple[Bench, PolicyNode, SpinThread]] = []

    def start(weight: float | None = None, speaks: bool = True, **parameters: Any) -> Bench:
        file = write_policy(tmp_path / "policy.onnx", TASK, weight)
        values = {"policy": str(file), "measure_timeout": 60.0, **parameters}
        overrides = [Parameter(name, value=value) for name, value in values.items()]
        node = PolicyNode("tripod", context=context, parameter_overrides=overrides)
        thread = SpinThread([node], context)
        thread.__enter__()
        bench = Bench(node, client, speaks)
        opened.append((bench, node, thread))
        assert client.node.wait_for_node("/tripod/policy", DEADLINE_S)
        return bench

    yield start
    for bench, node, thread in opened:
        bench.close()
        thread.close()
        node.close()
    context.try_shutdown()


def expected(file: Path, commands: list[float]) -> np.ndarray:
    """What the environment's own code commands on what the bench says."""
    policy = load_policy(file)
    heard = LatestReadings(policy.task.asks, policy.task.goal_size)
    heard.take("joint_positions", np.array(JOINTS), 0.0)
    heard.take_pose(Pose(np.array(PLACE), np.array(UPRIGHT)), 0.0)
    heard.aim(np.array(GOAL))
    heard.commands = np.array([commands])
    return policy.command(heard)[0]


@pytest.mark.slow
def test_it_commands_what_the_environment_would(
    start_policy: Callable[..., Bench], spin_until: Any, tmp_path: Path
) -> None:
    bench = start_policy()
    assert spin_until(lambda: bench.enable()[0])
    assert spin_until(lambda: bench.enabled.value is True)
    assert not bench.commands  # no goal yet
    bench.aim(GOAL)
    assert spin_until(lambda: len(bench.commands) >= 3)
    first, second = (list(each.data) for each in bench.commands[:2])
    assert first == expected(tmp_path / "policy.onnx", JOINTS).tolist()
    assert second == expected(tmp_path / "policy.onnx", first).tolist()
    assert bench.enable(False) == (True, "off: the command topic is free")
    assert spin_until(lambda: bench.enabled.value is False)
    sent, spoken = len(bench.commands), bench.spoken
    bench.aim([0.0, 0.0, 0.04])
    assert spin_until(lambda: bench.spoken > spoken + 25)  # messages that a policy which is on would answer
    assert len(bench.commands) <= sent + 1  # one may have been on its way


@pytest.mark.slow
def test_it_stays_off_until_all_is_heard_and_holds_when_it_is_not(
    start_policy: Callable[..., Bench], spin_until: Any
) -> None:
    bench = start_policy(speaks=False, measure_timeout=1.0)
    missing = "not switched on: nothing arrived within 1 s on joint_states, effector_pose"
    assert bench.enable() == (False, missing)
    bench.speaks, bench.joints = True, [math.nan, -1.0, -1.0]
    assert spin_until(lambda: bench.enable()[1].endswith("on joint_states"))
    assert not bench.commands
    bench.joints = list(JOINTS)
    assert spin_until(lambda: bench.enable()[0])
    bench.aim(GOAL)
    assert spin_until(lambda: len(bench.commands) >= 3)
    bench.place = [math.nan] * 3  # the camera sees nothing any more
    assert spin_until(lambda: bench.node._said.startswith("waiting: nothing arrived"))
    bench.commands.clear()
    assert spin_until(lambda: len(bench.commands) > 10)  # the servos are told to stay
    assert len({tuple(each.data) for each in bench.commands}) == 1
    bench.place = list(PLACE)
    assert spin_until(lambda: bench.node._said == "")
    assert bench.enabled.value is True


@pytest.mark.slow
def test_a_robot_that_is_not_as_it_was_learned_with_ends_it(
    start_policy: Callable[..., Bench], spin_until: Any
) -> None:
    bench = start_policy()
    bench.shift(0.0)
    assert spin_until(lambda: "shifted by 0 mm, the policy has learned with 35 mm" in bench.enable()[1])
    bench.shift(0.035)
    assert spin_until(lambda: bench.enable()[0])
    bench.aim(GOAL)
    assert spin_until(lambda: len(bench.commands) >= 3)
    bench.shift(0.0)
    assert spin_until(lambda: bench.enabled.value is False)
    assert "shifted" in bench.node._problem


def test_an_answer_that_is_not_finite_moves_nothing(
    start_policy: Callable[..., Bench], spin_until: Any
) -> None:
    bench = start_policy(weight=math.nan)
    assert spin_until(lambda: bench.enable()[0])
    bench.aim(GOAL)
    assert spin_until(lambda: bench.enabled.value is False)
    assert "not finite; nothing was moved" in bench.node._problem
    assert not bench.commands


def test_an_endless_policy_is_switched_off_and_the_service_answers(
    start_policy: Callable[..., Bench], spin_until: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("softsim_core.lab.learning.policy.LONGEST_ACTION_S", 0.2)
    bench = start_policy(policy=str(write_endless_policy(tmp_path / "endless.onnx", TASK)))
    bench.aim(GOAL)
    for _ in range(2):
        assert spin_until(lambda: bench.enable()[0])
        assert spin_until(lambda: "has not answered within 0.2 s" in bench.node._problem)
    assert bench.commands == []
    assert bench.enable(False) == (True, "off: the command topic is free")


@pytest.mark.slow
def test_up_ends_while_an_endless_policy_computes(
    start_process: Any, client: Any, spin_until: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SIGTERM comes as soon as it is switched on: its first action is never finished.

    Started with the robot, it may have been refused before the start move, so it is switched on again.
    """
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    policy = write_endless_policy(tmp_path / "endless.onnx", TASK)
    words = ["up", "tripod", "--no-viewer", "--no-bridge", "--policy", str(policy)]
    up = start_process("softsim_ros.cli", *words)
    states = client.collect(JointState, "joint_states", 1)
    assert spin_until(lambda: states, BUILD_S), up.output
    client.publish("effector_goal", pose_stamped(time_message(0.0), "world", GOAL, UPRIGHT))
    assert client.call(Trigger, "simulator/start").success
    assert spin_until(lambda: client.call(SetBool, "policy/enable", SetBool.Request(data=True)).success), (
        up.output
    )
    assert up.end(signal.SIGTERM) == 0, up.output
    assert "Traceback" not in up.output


def test_a_policy_of_another_robot_does_not_start(start_policy: Callable[..., Bench], tmp_path: Path) -> None:
    other = write_policy(tmp_path / "lift.onnx", "CableGripperLift-v0")
    with pytest.raises(SoftSimError, match="it drives cable_gripper"):
        start_policy(policy=str(other))
    with pytest.raises(SoftSimError, match="no file is named"):
        start_policy(policy="")


@pytest.mark.slow
@pytest.mark.parametrize(
    "where",
    [
        "environment",
        *(pytest.param(name, marks=pytest.mark.exhaustive) for name in ("simulator", "virtual board")),
        "emulated board",
        pytest.param("emulated board, all goals", marks=pytest.mark.exhaustive),
    ],
)
def test_the_shipped_policy_reaches_goals(
    where: str, start_process: Any, client: Any, spin_until: Any, tmp_path: Path
) -> None:
    """The same goals in turn: after three seconds each in the environment, each for a second on a robot.

    On the emulated board, which computes for all of that time, the first two of them are enough.
    """
    random = np.random.default_rng(1)
    goals = np.array([TASKS[TASK].goal(random) for _ in range(5)])
    if where == "environment":
        errors = errors_in_environment(goals)
        print(f"{where}: {np.round(1e3 * errors, 2).tolist()} mm")
        assert np.median(errors) < 0.002
        assert errors.max() < 0.003
        return
    board = where.partition(",")[0]
    if board == "emulated board" and (reason := why_missing()):
        assert not os.environ.get("REQUIRE_SIMAVR"), reason
        pytest.skip(reason)
    if where == "emulated board":
        goals = goals[:2]
    goals_are_reached_by_nodes(board, goals, start_process, client, spin_until, tmp_path)


def errors_in_environment(goals: np.ndarray) -> np.ndarray:
    """Distances from goals at the end in [m], shape (k,), with the environment's noise and latency."""
    policy, episodes, first = load_policy(SHIPPED), Episodes(TASKS[TASK], 1), np.array([0])
    observation, errors = episodes.begin(first), []
    for goal in goals:
        episodes._goals[0] = goal
        for _ in range(75):
            observation, outcome = episodes.act(first, policy.actions(observation))
        errors.append(outcome.info["distance_m"][0])
    return np.array(errors)


@contextmanager
def pulses_as_joints(board: EmulatedBoardPty, client: Any) -> Iterator[None]:
    """Tells where servos would be that obey the pulses on the board's pins, on `pulses`."""
    robot = load_scene("tripod")
    assert robot.board is not None
    servos = robot.board.servos
    publisher = client.publisher(JointState, "pulses")

    def tell() -> None:
        if (widths := board.widths_us()) is not None:
            angles = [width_to_angle(each, servo) for each, servo in zip(widths, servos, strict=True)]
            publisher.publish(JointState(name=[servo.joint for servo in servos], position=angles))

    timer = client.node.create_timer(0.02, tell)
    try:
        yield
    finally:
        client.node.destroy_timer(timer)


def goals_are_reached_by_nodes(
    where: str, goals: np.ndarray, start_process: Any, client: Any, spin_until: Any, folder: Path
) -> None:
    """Wait for each goal in turn until the simulated effector stays within 3 mm of it for a second.

    On a board the simulator follows the bytes that the bridge wrote, or the pulses that the firmware made of
    them: only they move the robot.
    """
    follows = {"simulator": "", "virtual board": "applied_joint_states", "emulated board": "pulses"}[where]
    simulator = ["--ros-args", "-p", "robot:=tripod"]
    if follows:
        simulator += ["-p", f"follow_joint_states:={follows}"]
    with ExitStack() as bench:
        started = [start_process("softsim_ros.nodes.simulator.simulator_node", *simulator)]
        assert started[0].says("simulating", BUILD_S), started[0].output
        poses = client.collect(PoseStamped, "effector_pose", 1)

        def stays_at(goal: list[float]) -> bool:
            places = [each.pose.position for each in poses[-100:]]
            return len(places) == 100 and all(math.dist((p.x, p.y, p.z), goal) < 0.003 for p in places)

        states = client.collect(JointState, "joint_states", 1)
        assert client.call(Trigger, "simulator/start").success
        assert spin_until(lambda: states and states[-1].position[0] < -1.49)
        if follows:
            link = folder / "board"
            board = bench.enter_context(
                VirtualBoard(link=link) if where == "virtual board" else EmulatedBoardPty(link=link)
            )
            if isinstance(board, EmulatedBoardPty):
                bench.enter_context(pulses_as_joints(board, client))
            words = [f"port:={board.port}", "source:=commands", "autostart:=activate", "open_wait_s:=0.0"]
            bridge = ["--ros-args", *(word for each in words for word in ("-p", each))]
            started.append(start_process("servo_bridge.nodes.bridge_node", *bridge))
        started.append(
            start_process("softsim_ros.nodes.policy.policy_node", "--ros-args", "-p", f"policy:={SHIPPED}")
        )
        assert started[-1].says("call policy/enable", BUILD_S), started[-1].output

        def enable() -> bool:
            return bool(client.call(SetBool, "policy/enable", SetBool.Request(data=True)).success)

        assert spin_until(enable), started[-1].output
        for goal in goals.tolist():
            client.publish("effector_goal", pose_stamped(time_message(0.0), "world", goal, UPRIGHT))
            poses.clear()
            assert spin_until(lambda goal=goal: stays_at(goal)), (goal, poses[-1:])
        for process in reversed(started):
            assert process.end() == 0
