"""The path follower over its topics and services."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros

from geometry_msgs.msg import PoseStamped  # noqa: E402
from nav_msgs.msg import Path as PathMessage  # noqa: E402
from rcl_interfaces.srv import SetParametersAtomically  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from std_msgs.msg import Bool, Float64  # noqa: E402
from std_srvs.srv import SetBool, Trigger  # noqa: E402
from waiting import DEADLINE_S  # noqa: E402

from softsim_core.base import ConfigError  # noqa: E402
from softsim_core.control.inverse import find_path  # noqa: E402
from softsim_node import STATE_QOS  # noqa: E402
from softsim_ros import SpinThread, StateListener  # noqa: E402
from softsim_ros.messages import pose_stamped, time_message  # noqa: E402
from softsim_ros.nodes.inverse import PathFollower  # noqa: E402

FACTS = ("enabled", "playing", "paused", "file")
PLAN = '{"anglePlanningTable": [[0.1, 0.0], [0.0, -0.1]]}'


class Bench:
    """A path follower and what it says."""

    def __init__(self, follower: PathFollower, client: Any) -> None:
        self.follower, self.client = follower, client
        self.goals: list[Any] = client.collect(PoseStamped, "effector_goal")
        self.progress: list[Any] = client.collect(Float64, "path_follower/progress")
        self._told = {name: StateListener(client.node, f"path_follower/{name}") for name in FACTS}

    def start(self) -> tuple[bool, str]:
        answer = self.client.call(Trigger, "path_follower/start")
        return answer.success, answer.message

    def switch(self, name: str, on: bool) -> tuple[bool, str]:
        answer = self.client.call(SetBool, f"path_follower/{name}", SetBool.Request(data=on))
        return answer.success, answer.message

    def tells(self, **facts: object) -> bool:
        """Whether the newest of these state topics say so."""
        return {name: self._told[name].value for name in facts} == facts


@pytest.fixture
def start_follower(ros_domain: int, client: Any, tmp_path: Path) -> Iterator[Callable[..., Bench]]:
    context = Context()
    context.init(args=[], domain_id=ros_domain)
    opened: list[tuple[PathFollower, SpinThread]] = []

    def start(plan: str | None = PLAN, **parameters: Any) -> Bench:
        if plan is not None:
            file = tmp_path / "plan.json"
            file.write_text(plan)
            parameters["file"] = str(file)
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        follower = PathFollower("tripod", context=context, parameter_overrides=overrides)
        thread = SpinThread([follower], context)
        opened.append((follower, thread))
        thread.__enter__()
        bench = Bench(follower, client)
        assert client.node.wait_for_node("/tripod/path_follower", DEADLINE_S)
        return bench

    yield start
    for follower, thread in opened:
        thread.close()
        follower.close()
    context.try_shutdown()


def test_a_plan_is_played_to_its_end(start_follower: Any, spin_until: Any) -> None:
    bench = start_follower(enable_inverse=False, speed=4.0)
    assert not bench.goals  # nothing is sent before the start
    assert spin_until(lambda: bench.tells(enabled=True, playing=False, paused=False))
    assert bench.start() == (True, "path started: 1 s")
    assert spin_until(lambda: bench.progress and bench.progress[-1].data == 100.0)
    assert spin_until(lambda: bench.tells(playing=False, paused=False))
    end = pytest.approx((0.05, -math.sin(0.05), 0.0))  # 30 mm at rest, 20 mm up

    def last() -> tuple[float, ...]:
        pose = bench.goals[-1].pose
        return pose.position.z, pose.orientation.x, pose.orientation.y

    assert spin_until(lambda: last() == end), last()
    count = len(bench.goals)
    assert bench.goals[-1].header.frame_id == "world"
    assert bench.switch("pause", True) == (False, "no path is running (it is ended); call start first")
    assert len(bench.goals) == count  # the last goal is held by whoever follows it
    assert bench.start()[0]
    assert spin_until(lambda: len(bench.goals) > count)


@pytest.mark.slow
def test_pause_and_enable(start_follower: Any, spin_until: Any) -> None:
    bench = start_follower(enable_inverse=False, loop=True)
    assert bench.switch("enable", False) == (True, "off: no goals are given")
    assert bench.start() == (False, "the path follower is off; call path_follower/enable with true first")
    assert bench.switch("enable", True) == (True, "ready")
    assert bench.start()[0]
    assert spin_until(lambda: len(bench.goals) > 5)
    assert spin_until(lambda: bench.tells(playing=True, paused=False))
    done, sentence = bench.switch("pause", True)
    assert done
    assert sentence.startswith("paused at ")
    time = bench.follower._player.time
    assert spin_until(lambda: bench.tells(playing=False, paused=True))
    assert bench.follower._player.time == time
    assert bench.switch("pause", False)[0]
    assert spin_until(lambda: bench.follower._player.rounds > 0)  # the plan takes one second
    assert bench.switch("enable", False)[0]
    assert spin_until(lambda: bench.tells(enabled=False, playing=False, paused=False))


@pytest.mark.slow
def test_the_inverse_controller_is_switched_on_and_off_stops_the_path(
    start_follower: Any, client: Any, spin_until: Any
) -> None:
    calls: list[bool] = []
    ready = threading.Event()

    def answer(request: Any, response: Any) -> Any:
        calls.append(request.data)
        response.success, response.message = ready.is_set(), "the joints were not heard of yet"
        return response

    tasks: list[str] = []

    def set_task(request: Any, response: Any) -> Any:
        tasks.extend(parameter.value.string_value for parameter in request.parameters)
        response.result.successful = True
        return response

    service = client.node.create_service(SetBool, "inverse_controller/enable", answer)
    parameters = client.node.create_service(
        SetParametersAtomically, "inverse_controller/set_parameters_atomically", set_task
    )
    try:
        bench = start_follower(loop=True)
        assert spin_until(lambda: bench.follower._inverse.is_there)
        trouble = "the inverse controller cannot be switched on: the joints were not heard of yet"
        assert bench.start()[0]
        assert spin_until(lambda: bench.follower._problem == f"not started: {trouble}")
        assert bench.follower._player.state == "idle"
        count = len(calls)
        assert count > 1  # it asked again
        assert bench.start()[0]
        assert spin_until(lambda: bench.follower._problem == f"waiting: {trouble}")
        ready.set()
        assert spin_until(lambda: bench.follower._player.state == "running")
        assert bench.follower._problem == ""
        enabled = client.node.create_publisher(Bool, "inverse_controller/enabled", STATE_QOS)
        enabled.publish(Bool(data=True))
        assert spin_until(lambda: bench.follower._inverse.is_on)
        assert bench.follower._player.state == "running"
        enabled.publish(Bool(data=False))
        assert spin_until(lambda: bench.follower._player.state == "idle")
        assert bench.follower._problem.startswith("stopped: the inverse controller was switched off")
        client.node.destroy_publisher(enabled)
        assert tasks == ["height_tilt", "height_tilt"]
        assert bench.follower.set_parameters([Parameter("file", value="circle")])[0].successful
        assert bench.start()[0]
        assert spin_until(lambda: tasks[2:] == ["position"])  # the Tripod's own
    finally:
        client.node.destroy_service(service)
        client.node.destroy_service(parameters)


def test_it_starts_when_inverse_control_is_switched_on(
    start_follower: Any, client: Any, spin_until: Any
) -> None:
    bench = start_follower(start_with_inverse=True)
    enabled = client.node.create_publisher(Bool, "inverse_controller/enabled", STATE_QOS)
    enabled.publish(Bool(data=False))
    enabled.publish(Bool(data=True))
    assert spin_until(lambda: bench.follower._player.state == "running")
    assert spin_until(lambda: len(bench.goals) > 0)
    assert client.node.destroy_publisher(enabled)  # as where the controller ends
    assert spin_until(lambda: bench.follower._player.state == "idle")


@pytest.mark.slow
def test_a_path_waits_for_a_controller_that_is_silent(
    start_follower: Any, client: Any, spin_until: Any
) -> None:
    """A process that the machine pauses for seconds goes on where it was; one that has ended does not."""
    bench = start_follower(start_with_inverse=True, loop=True)
    follower = bench.follower
    enabled = client.node.create_publisher(Bool, "inverse_controller/enabled", STATE_QOS)
    enabled.publish(Bool(data=True))
    assert spin_until(lambda: follower._player.state == "running")
    lease = follower._inverse._state._on_liveliness
    lease(SimpleNamespace(alive_count_change=-1))
    assert follower._problem == "waiting: the inverse controller is silent"
    assert spin_until(lambda: bench.tells(playing=False, paused=True))
    lease(SimpleNamespace(alive_count_change=1))
    assert follower._problem == ""
    assert spin_until(lambda: bench.tells(playing=True, paused=False))
    assert bench.switch("pause", True)[0]
    lease(SimpleNamespace(alive_count_change=-1))
    lease(SimpleNamespace(alive_count_change=1))
    assert follower._player.state == "paused"  # as a person left it
    assert bench.switch("pause", False)[0]
    lease(SimpleNamespace(alive_count_change=-1))
    assert bench.switch("pause", True)[0]
    lease(SimpleNamespace(alive_count_change=1))
    assert follower._player.state == "paused"  # as a person asked for in the silence
    lease(SimpleNamespace(alive_count_change=-1))
    assert client.node.destroy_publisher(enabled)
    assert spin_until(lambda: follower._player.state == "idle")


def path_message(frame: str = "world", spacing: float = 0.2) -> PathMessage:
    message = PathMessage()
    message.header.frame_id = frame
    for k in range(3):
        stamp = time_message(100.0 + spacing * k)
        message.poses.append(pose_stamped(stamp, "", (0.0, 0.001 * k, 0.04), (0.0, 0.0, 0.0, 1.0)))
    return message


@pytest.mark.slow
def test_a_path_comes_as_a_message(start_follower: Any, client: Any, spin_until: Any) -> None:
    bench = start_follower(None, enable_inverse=False)
    assert bench.start() == (
        False,
        "there is no path; set the parameter file, or send one on the topic path",
    )
    for wrong, sentence in (
        (path_message(frame="moon"), "unknown frame_id 'moon'; allowed: world, tripod/base_link"),
        (path_message(spacing=0.0), "path refused at pose 1: times must be >= 0 s and strictly increasing"),
    ):
        client.publish("path", wrong)
        assert spin_until(lambda sentence=sentence: sentence in bench.follower._problem)
    client.publish("path", path_message())
    assert spin_until(lambda: bench.follower._received is not None)
    assert bench.start() == (True, "path started: 0.4 s")
    assert spin_until(lambda: bench.tells(file=""))
    assert spin_until(lambda: bench.goals and bench.goals[-1].pose.position.y == pytest.approx(0.002))


@pytest.mark.slow
def test_a_maze_plan_can_begin_where_the_effector_is(
    start_follower: Any, client: Any, spin_until: Any
) -> None:
    bench = start_follower(enable_inverse=False, start_from="measured", autostart=True)
    pose = pose_stamped(time_message(0.0), "world", (0.001, 0.002, 0.025), (0.0, 0.0, 0.0, 1.0))
    client.publish("effector_pose", pose)
    assert spin_until(lambda: bench.goals)
    assert bench.goals[0].pose.position.x == pytest.approx(0.001)
    assert bench.goals[0].pose.position.z == pytest.approx(0.025, abs=2e-3)


@pytest.mark.slow
def test_wrong_files_are_one_sentence(start_follower: Any, spin_until: Any) -> None:
    with pytest.raises(ConfigError, match="row 1: must be two finite angles"):
        start_follower('{"anglePlanningTable": [[0.1]]}')
    with pytest.raises(ConfigError, match=r"no such file, and no known path; known paths: circle\.csv"):
        start_follower(None, file="nowhere.csv")
    bench = start_follower(None)
    result = bench.follower.set_parameters([Parameter("file", value="nowhere.csv")])[0]
    assert not result.successful
    assert "known paths" in result.reason
    for path in (str(find_path("circle")), "~nobody/x", 5000 * "a", "a" + chr(0)):
        refused = bench.follower.set_parameters([Parameter("file", value=path)])[0]
        assert not refused.successful
        assert "at run time it is a name in configs/paths" in refused.reason
        assert len(refused.reason) <= 300
    assert bench.follower.set_parameters([Parameter("file", value="circle")])[0].successful
    assert bench.start()[0]
    assert spin_until(lambda: bench.tells(file="circle"))


@pytest.mark.slow
def test_its_robot_stays_the_same(start_follower: Any) -> None:
    follower = start_follower(None).follower
    assert not follower.set_parameters([Parameter("robot", value="cable_gripper")])[0].successful
    assert follower.get_parameter("robot").value == "tripod"
