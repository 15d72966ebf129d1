"""A script's client and a real simulator: what it reads, asks and refuses; the example as it stands."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from waiting import BUILD_S, DEADLINE_S

pytest.importorskip("rclpy")

from rclpy.context import Context
from rclpy.parameter import Parameter

from softsim_core.scene import load_scene
from softsim_ros import SpinThread
from softsim_ros.cli.running import run
from softsim_ros.client import (
    ClientError,
    EffectorPose,
    RobotChoiceError,
    RobotSession,
    RunningRobot,
    connect,
    discovery,
    running_robot,
    running_robots,
)
from softsim_ros.nodes.simulator import Simulator

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.shared_robot("tripod")]

REPOSITORY = Path(__file__).resolve().parents[2]
MID = load_scene("tripod").poses["mid"]


@pytest.fixture
def robot(tripod: Any, ros_domain: int) -> Iterator[RobotSession]:
    with connect("tripod", domain=ros_domain, within_s=DEADLINE_S) as session:
        yield session


def test_the_example_runs_as_it_stands(tripod: Any) -> None:
    done = subprocess.run(
        [sys.executable, str(REPOSITORY / "examples" / "drive_a_robot.py")],
        cwd=REPOSITORY,
        env=None,
        capture_output=True,
        text=True,
        timeout=BUILD_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert "mid [-1.05, -1.05, -1.05]" in lines
    assert "servo_0 stops at its upper limit -0.0255 rad (-1.5 deg)" in lines
    assert lines[-1].startswith("nothing moved: unknown pose upside_down; known: ")


def test_commands_arrive_within_limits_and_the_state_follows(robot: RobotSession) -> None:
    assert robot.do(robot.client.joints.go_to, "mid") == "pose mid"
    state = robot.wait_until_there(DEADLINE_S)
    assert state.measured == pytest.approx(MID, abs=0.02)
    assert len(state.efforts) == 3
    assert (state.simulator, state.bridge, state.inverse) == ("running", "not running", False)
    assert "servo_2 stops at its upper limit" in robot.do(robot.client.joints.command, [-1.0, -1.0, 5.0])
    assert robot.state.commanded == pytest.approx((-1.0, -1.0, -0.0255))
    for values, words in (
        ([0.0], "command of 1 values refused: expected 3"),
        (["a", 0.0, 0.0], "expected a finite number"),
        (7.0, "Joints.command refused: TypeError"),
    ):
        with pytest.raises(ClientError, match=words):
            robot.do(robot.client.joints.command, values)


def test_time_stands_still_steps_and_begins_anew(robot: RobotSession) -> None:
    simulator = robot.client.simulator
    robot.do(simulator.step)  # pauses first
    assert robot.state.simulator == "paused"
    measured_at = robot.wait_until(lambda state: state.measured is not None, DEADLINE_S).measured_at
    robot.do(simulator.step)
    robot.wait_until(lambda state: state.measured_at > measured_at, DEADLINE_S, what="a step")
    robot.do(simulator.toggle_pause)
    assert robot.state.simulator == "running"
    robot.do(robot.client.joints.go_to, "mid")
    robot.wait_until_there(DEADLINE_S)
    robot.do(simulator.reset)
    robot.wait_until(lambda state: max(map(abs, state.measured or (1.0,))) < 0.02, DEADLINE_S, what="a reset")
    robot.do(simulator.parameters.set, "enforce_limits", False)
    robot.wait_until(lambda state: state.enforce_limits is False, DEADLINE_S, what="free joints")
    with pytest.raises(ClientError, match="refused: "):
        robot.do(simulator.parameters.set, "speed", -1.0)


@pytest.mark.parametrize(("presses", "after"), [(1, "paused"), (2, "running"), (3, "paused"), (4, "running")])
def test_presses_faster_than_the_answers_all_count(robot: RobotSession, presses: int, after: str) -> None:
    simulator = robot.client.simulator
    robot.do(simulator.pause, False)

    def press(done: Callable[[Any], None]) -> None:
        for _ in range(presses - 1):
            simulator.toggle_pause()
        simulator.toggle_pause(done)

    robot.do(press)
    robot.wait_until(lambda state: state.simulator == after, DEADLINE_S, what=after)
    robot.do(simulator.pause, False)


def test_what_is_not_there_is_refused_in_a_sentence(robot: RobotSession, ros_domain: int) -> None:
    client = robot.client
    for action, words in (
        (client.bridge.start, "no servo bridge on /tripod/servo_bridge"),
        (client.bridge.stop, "no servo bridge on /tripod/servo_bridge"),
        (client.bridge.e_stop, "servo bridge is not running"),
        (client.inverse.toggle, "inverse control is not running"),
    ):
        with pytest.raises(ClientError, match=words):
            robot.do(action)
    with pytest.raises(ClientError, match="inverse control is off"):
        robot.do(client.inverse.give_goal, EffectorPose((0.0, 0.0, 0.03), (0.0, 0.0, 0.0, 1.0)))
    with pytest.raises(ClientError, match=r"did not hold within .* simulator running, bridge not"):
        robot.wait_until(lambda _: False, 0.1)
    elsewhere = connect("tripod", namespace="nowhere", domain=ros_domain, within_s=0.5)
    with pytest.raises(ClientError, match="no robot answers in /nowhere within"), elsewhere:
        pass


def test_running_robots_are_found(robot: RobotSession, client: Any, spin_until: Any) -> None:
    assert spin_until(lambda: running_robots(client.node) == ["/tripod"])


@pytest.fixture
def soon(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Makes it sooner that no other robot is waited for; who waits for both of two asks again."""
    return lambda: monkeypatch.setattr(discovery, "OTHERS_S", 0.3)


def test_the_robot_that_runs_is_found_where_none_is_named(
    tripod: Any, ros_domain: int, spin_until: Any, soon: Callable[[], None]
) -> None:
    assert running_robot(within_s=DEADLINE_S) == RunningRobot("tripod", "/tripod")
    soon()
    assert running_robot("tripod", within_s=DEADLINE_S).robot == "tripod"  # type: ignore[union-attr]
    assert running_robot("elsewhere", within_s=0.5) is None
    with connect(domain=ros_domain, within_s=DEADLINE_S) as session:
        assert session.client.robot.name == "tripod"
    words = ["--ros-args", "-p", "robot:=tripod", "-r", "__ns:=/tripod"]
    assert spin_until(lambda: run._name_running_robot([]) == words)
    assert (
        run._name_running_robot(["--ros-args", "-p", "robot:=tentacle"])
        == run._name_running_robot(["--help"])
        == []
    )
    topics = [sys.executable, "-m", "softsim_ros.cli", "topics", "--echo", "joint_states", "--count", "1"]
    done = subprocess.run(
        topics, cwd=REPOSITORY, capture_output=True, text=True, timeout=DEADLINE_S, check=False
    )
    assert "servo_0" in done.stdout, done.stderr


@pytest.fixture
def second_robot(ros_domain: int) -> Iterator[None]:
    """Another Tripod, in this process and in the namespace /second."""
    context = Context()
    context.init(args=["--ros-args", "--disable-rosout-logs"], domain_id=ros_domain)
    overrides = [Parameter("backend", value="scipy")]
    second = Simulator("tripod", context=context, namespace="/second", parameter_overrides=overrides)
    second.physics.pause(True)
    try:
        with SpinThread([second], context):
            yield
    finally:
        second.close()
        context.try_shutdown()


def test_of_several_robots_one_has_to_be_named(
    tripod: Any, second_robot: None, spin_until: Any, client: Any, soon: Callable[[], None]
) -> None:
    soon()
    assert spin_until(lambda: running_robots(client.node) == ["/second", "/tripod"])

    def refusal() -> str:
        """Why none is chosen; empty while only one of them is found."""
        try:
            running_robot(within_s=DEADLINE_S)
        except RobotChoiceError as error:
            return str(error)
        return ""

    assert spin_until(lambda: "several robots run: /second, /tripod; name the one" in refusal())
    assert running_robot("second", within_s=DEADLINE_S) == RunningRobot("tripod", "/second")
