"""The simulator's action FollowJointTrajectory, as MoveIt and scripts use it on ros2_control's controller."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.slow]

from action_msgs.msg import GoalStatus  # noqa: E402
from builtin_interfaces.msg import Duration  # noqa: E402
from interface_packages import interface_package  # noqa: E402
from node_processes import ProcessGroup, parameter_words  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint  # noqa: E402
from waiting import spin_until  # noqa: E402

ACTION = "joint_trajectory_controller/follow_joint_trajectory"
JOINTS = ["servo_0", "servo_1", "servo_2"]
LONG_S = 600.0
START = [-0.3] * 3


@pytest.fixture(scope="module")
def control_msgs() -> Iterator[None]:
    """The package control_msgs, here and in the processes of these tests."""
    with interface_package("control_msgs"):
        yield


@pytest.fixture(scope="module")
def running_tripod(control_msgs: None, start_robot: Callable[..., Any]) -> Any:
    """One Tripod for the tests of this module, started with the package."""
    return start_robot()


class Sent:
    """A goal that was sent: what came back of it."""

    def __init__(self, in_turn: Callable[[Callable[[], Any]], Any], client: Any, goal: Any) -> None:
        self.feedback: list[Any] = []
        self._in_turn = in_turn
        answer = in_turn(lambda: client.send_goal_async(goal, feedback_callback=self._on_feedback))
        assert spin_until(answer.done), "no answer to the goal"
        self._goal = answer.result()
        self.accepted = self._goal.accepted
        self._end = in_turn(self._goal.get_result_async) if self.accepted else None

    def _on_feedback(self, message: Any) -> None:
        self.feedback.append(message.feedback)

    @property
    def status(self) -> int:
        return int(self._goal.status)

    def cancel(self) -> Any:
        answer = self._in_turn(self._goal.cancel_goal_async)
        assert spin_until(answer.done), "no answer to the cancel request"
        return answer.result()

    def end(self) -> tuple[int, int, str]:
        """Status, error code and sentence of the result."""
        assert self.accepted
        assert spin_until(self._end.done), "no result"
        answer = self._end.result()
        return answer.status, answer.result.error_code, answer.result.error_string


class Arm:
    """The Tripod as a client of the action sees it."""

    def __init__(self, robot: Any) -> None:
        from control_msgs.action import FollowJointTrajectory
        from control_msgs.msg import JointTolerance

        self.robot, self.kind, self.tolerance = robot, FollowJointTrajectory, JointTolerance
        self._client = robot.client.action(FollowJointTrajectory, ACTION)
        self.states = robot.client.collect(JointState, "joint_states")
        robot.command(START)
        assert self.reaches(START)

    def goal(self, points: list[tuple[float, list[float]]], joints: list[str] = JOINTS, **fields: Any) -> Any:
        way = [
            JointTrajectoryPoint(positions=positions, time_from_start=duration(time))
            for time, positions in points
        ]
        return self.kind.Goal(trajectory=JointTrajectory(joint_names=joints, points=way), **fields)

    def send(self, goal: Any) -> Sent:
        return Sent(self.robot.client.in_turn, self._client, goal)

    def start_long(self) -> Sent:
        """A goal that is on its way, and stays so."""
        sent = self.send(self.goal([(LONG_S, [-1.0] * 3)]))
        assert spin_until(lambda: sent.feedback)
        return sent

    def reaches(self, positions: list[float]) -> bool:
        return spin_until(lambda: self.states and np.allclose(self.states[-1].position, positions, atol=1e-6))

    def close(self) -> None:
        self._client.destroy()


@pytest.fixture
def arm(tripod: Any) -> Iterator[Arm]:
    made = Arm(tripod)
    yield made
    made.close()


def duration(seconds: float) -> Duration:
    whole, part = divmod(seconds, 1.0)
    return Duration(sec=int(whole), nanosec=round(1e9 * part))


def test_a_goal_is_followed_told_about_and_reached(arm: Arm) -> None:
    sent = arm.send(arm.goal([(0.4, [-0.5, -0.6]), (0.8, [-0.7, -0.6])], joints=["servo_2", "servo_0"]))
    assert sent.end() == (GoalStatus.STATUS_SUCCEEDED, arm.kind.Result.SUCCESSFUL, "goal reached")
    assert arm.reaches([-0.6, START[1], -0.7])
    assert {tuple(each.joint_names) for each in sent.feedback} == {("servo_2", "servo_0")}
    times = [each.desired.time_from_start.nanosec * 1e-9 for each in sent.feedback]
    assert times == sorted(times)
    desired = np.array([each.desired.positions for each in sent.feedback])
    wanted = np.interp(times, [0.0, 0.4, 0.8], [START[2], -0.5, -0.7])
    np.testing.assert_allclose(desired[:, 0], wanted, atol=1e-6)
    for each in sent.feedback:
        np.testing.assert_allclose(
            each.error.positions, np.subtract(each.desired.positions, each.actual.positions)
        )
        assert np.abs(each.error.positions).max() < 1e-6  # 0.5 rad/s is no effort for these servos
        assert each.desired.velocities[0] in (pytest.approx(-0.5), 0.0)
    assert sent.feedback[-1].header.stamp.sec > 0


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"joints": ["servo_0", "servo_1", "elbow"]}, "unknown joint elbow; known joints: servo_0"),
        ({"points": []}, "it has no way points"),
        ({"points": [(1.0, [-0.4] * 3), (0.5, [-0.4] * 3)]}, "strictly increasing"),
        (
            {"points": [(1.0, [-0.4, -9.0, -0.4])]},
            "is beyond the limits of joint servo_1, [-2.0225, -0.0255]",
        ),
        ({"path": ("elbow", 0.1, 0.0, 0.0)}, "path_tolerance names elbow, the trajectory moves servo_0"),
        ({"goal": ("servo_0", np.nan, 0.0, 0.0)}, "goal_tolerance of servo_0 is not finite"),
        ({"goal": ("servo_0", 0.0, 0.0, 1.0)}, "its accelerations are not measured"),
    ],
)
def test_goals_that_cannot_be_meant_are_rejected_in_a_sentence(
    arm: Arm, fields: dict[str, Any], sentence: str
) -> None:
    points = fields.get("points", [(1.0, [-0.4] * 3)])
    tolerances = {
        f"{name}_tolerance": [
            arm.tolerance(**dict(zip(("name", "position", "velocity", "acceleration"), words, strict=True)))
        ]
        for name, words in fields.items()
        if name in ("path", "goal")
    }
    goal = arm.goal(points, joints=fields.get("joints", JOINTS), **tolerances)
    assert spin_until(lambda: not arm.send(goal).accepted and sentence in arm.robot.process.output)
    assert arm.reaches(START)


def test_a_cancelled_goal_stops_where_it_is(arm: Arm) -> None:
    sent = arm.start_long()
    assert spin_until(lambda: sent.status == GoalStatus.STATUS_EXECUTING)
    answer = sent.cancel()
    assert len(answer.goals_canceling) == 1
    status, _, sentence = sent.end()
    assert (status, sentence) == (
        GoalStatus.STATUS_CANCELED,
        "goal abandoned: it was cancelled; the joints stay at their last commands",
    )
    stands(arm)


def stands(arm: Arm) -> None:
    """The joints are somewhere between start and goal, and move no more."""

    def places() -> set[tuple[float, ...]]:
        return {tuple(state.position) for state in arm.states[-20:]}

    arm.states.clear()
    assert spin_until(lambda: len(arm.states) > 20 and len(places()) == 1)
    assert all(-1.0 < position <= START[0] for position in places().pop())


def another_trajectory(arm: Arm) -> None:
    way = [JointTrajectoryPoint(positions=[-0.4] * 3, time_from_start=duration(0.1))]
    arm.robot.client.publish("joint_trajectory", JointTrajectory(joint_names=JOINTS, points=way))


@pytest.mark.parametrize(
    ("interrupt", "reason"),
    [
        (lambda arm: arm.robot.command(START), "another command took over"),
        (
            lambda arm: arm.robot.client.publish(
                "joint_commands", JointState(name=["servo_0"], position=[-0.5])
            ),
            "another command took over",
        ),
        (another_trajectory, "another command took over"),
        (lambda arm: arm.send(arm.goal([(0.1, START)])), "another command took over"),
        (lambda arm: arm.robot.trigger("reset"), "the simulation was reset"),
        (lambda arm: arm.robot.trigger("start"), "the start animation began"),
        (lambda arm: arm.robot.pause(True), "the simulation was paused"),
    ],
    ids=["positions", "by_name", "trajectory", "goal", "reset", "start", "pause"],
)
def test_what_takes_the_joints_ends_the_goal_in_a_sentence(
    arm: Arm, interrupt: Callable[[Arm], Any], reason: str
) -> None:
    sent = arm.start_long()
    interrupt(arm)
    status, code, sentence = sent.end()
    assert (status, code) == (GoalStatus.STATUS_ABORTED, arm.kind.Result.INVALID_GOAL)
    assert sentence == f"goal abandoned: {reason}; the joints stay at their last commands"


def test_a_new_goal_takes_over_and_reaches_its_end(arm: Arm) -> None:
    first = arm.start_long()
    second = arm.send(arm.goal([(0.3, [-0.5] * 3)]))
    assert first.end()[0] == GoalStatus.STATUS_ABORTED
    assert second.end()[0] == GoalStatus.STATUS_SUCCEEDED
    assert arm.reaches([-0.5] * 3)


def test_a_paused_simulation_takes_no_goals(arm: Arm) -> None:
    arm.robot.pause(True)
    assert not arm.send(arm.goal([(0.3, [-0.5] * 3)])).accepted
    assert arm.robot.process.says("the simulation is paused")


FAST = [(0.1, [-2.0] * 3)]
"""17 rad/s, where the servos make 3.5."""


def test_a_trajectory_that_is_too_fast_is_reached_late_where_nothing_is_asked(arm: Arm) -> None:
    sent = arm.send(arm.goal(FAST))
    assert sent.end()[:2] == (GoalStatus.STATUS_SUCCEEDED, arm.kind.Result.SUCCESSFUL)
    assert spin_until(lambda: arm.states[-1].position[0] <= -1.98)  # a topic may come behind the result


def test_leaving_the_path_aborts(arm: Arm) -> None:
    sent = arm.send(arm.goal(FAST, path_tolerance=[arm.tolerance(name="servo_1", position=0.05)]))
    status, code, sentence = sent.end()
    assert (status, code) == (GoalStatus.STATUS_ABORTED, arm.kind.Result.PATH_TOLERANCE_VIOLATED)
    assert sentence.startswith("path tolerance violated: joint servo_1 is 0.")
    assert sentence.endswith("s, allowed are 0.05 rad")


def test_missing_the_goal_aborts_after_the_time_that_was_given(arm: Arm) -> None:
    sent = arm.send(arm.goal(FAST, goal_time_tolerance=duration(0.1)))
    status, code, sentence = sent.end()
    assert (status, code) == (GoalStatus.STATUS_ABORTED, arm.kind.Result.GOAL_TOLERANCE_VIOLATED)
    assert "after 0.21 s, allowed are 0.02 rad" in sentence


def test_the_bridge_s_e_stop_ends_a_goal_and_holds_off_others(
    arm: Arm, start_process: ProcessGroup, tmp_path: Path
) -> None:
    port = tmp_path / "board"
    board = start_process("servo_bridge.nodes.virtual_board_node", "--ros-args", *parameter_words(link=port))
    assert board.says("virtual board on")
    values = {"port": port, "open_wait_s": 0.0, "autostart": "activate"}
    bridge = start_process("servo_bridge.nodes.bridge_node", "--ros-args", *parameter_words(**values))
    sent = arm.start_long()
    assert arm.robot.client.call(Trigger, "servo_bridge/e_stop").success
    assert "goal abandoned: the e-stop was pressed" in sent.end()[2]
    stands(arm)
    assert not arm.send(arm.goal([(0.3, [-0.5] * 3)])).accepted
    assert arm.robot.process.says("call servo_bridge/clear_e_stop")
    assert arm.robot.client.call(Trigger, "servo_bridge/clear_e_stop").success
    assert spin_until(lambda: arm.send(arm.goal([(0.1, START)])).accepted)
    assert bridge.end() == 0
    assert board.end() == 0


def test_the_controller_itself_gets_the_goals_while_it_is_there(arm: Arm) -> None:
    from rclpy.node import Node

    sent = arm.start_long()
    node = arm.robot.client.node
    namespace = node.get_namespace()
    service = f"{namespace}/{ACTION}/_action/send_goal"
    controller = Node("joint_trajectory_controller", context=arm.robot.client.context, namespace=namespace)
    try:
        assert "joint_trajectory_controller is there now" in sent.end()[2]
        assert spin_until(lambda: node.count_services(service) == 0)
    finally:
        controller.destroy_node()
    assert spin_until(lambda: node.count_services(service) == 1)


NUMBERS = (0.0, -0.4, 1.0, -1.0, 1.0e-300, 1.0e300, np.nan, np.inf, -np.inf)
NAMES = ("servo_0", "servo_1", "servo_2", "", "elbow", "servo_0\n\x1b[31m", "x" * 300)


def test_nonsense_is_answered_and_the_next_goal_is_followed(arm: Arm) -> None:
    random = np.random.default_rng(11)

    def numbers(most: int) -> list[float]:
        return [float(each) for each in random.choice(NUMBERS, random.integers(most))]

    def tolerances() -> list[Any]:
        return [
            arm.tolerance(name=str(random.choice(NAMES)), position=float(random.choice(NUMBERS)))
            for _ in range(random.integers(3))
        ]

    for _ in range(300):
        way = [
            JointTrajectoryPoint(
                positions=numbers(5),
                velocities=numbers(3),
                time_from_start=Duration(sec=int(random.integers(-(2**31), 2**31)), nanosec=0),
            )
            for _ in range(random.integers(4))
        ]
        goal = arm.goal([], joints=[str(each) for each in random.choice(NAMES, random.integers(4))])
        goal.trajectory.points = way
        goal.trajectory.header.stamp.sec = int(random.choice([0, 0, -5, 2**31 - 1]))
        goal.path_tolerance, goal.goal_tolerance = tolerances(), tolerances()
        arm.send(goal)
    assert arm.send(arm.goal([(0.3, [-0.5] * 3)])).end()[0] == GoalStatus.STATUS_SUCCEEDED


def test_a_goal_that_ends_when_nobody_serves_the_node_any_more_leaves_the_physics_alone(
    arm: Arm, ros_domain: int
) -> None:
    from rclpy.context import Context
    from rclpy.parameter import Parameter

    from softsim_ros import SpinThread
    from softsim_ros.nodes.simulator import Simulator

    context = Context()
    context.init(args=["--ros-args", "--disable-rosout-logs"], domain_id=ros_domain)
    overrides = [Parameter("backend", value="scipy")]
    simulator = Simulator("tripod", context=context, namespace="/aside", parameter_overrides=overrides)
    served = SpinThread([simulator], context)
    try:
        with served:
            client = arm.robot.client.action(arm.kind, f"/aside/{ACTION}")
            sent = Sent(arm.robot.client.in_turn, client, arm.goal([(0.3, START)]))
            assert spin_until(lambda: sent.feedback)
        assert spin_until(lambda: not simulator.physics.status.trajectory)
        steps = simulator.physics.status.steps
        assert spin_until(lambda: simulator.physics.status.steps > steps)
        client.destroy()
    finally:
        simulator.close()
        context.try_shutdown()


def test_the_end_of_the_simulator_in_the_middle_of_a_goal_is_an_ordinary_one(arm: Arm) -> None:
    arm.start_long()
    assert arm.robot.process.end() == 0
    assert "Traceback" not in arm.robot.process.output
