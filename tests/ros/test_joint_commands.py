"""The simulator under ros2_control's topic hardware interface, and commands by name from anybody."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.shared_robot("tripod")]

from builtin_interfaces.msg import Duration, Time  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import Float64MultiArray, Header, String  # noqa: E402
from topic_hardware import TopicHardware  # noqa: E402
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint  # noqa: E402

from softsim_ros import SpinThread  # noqa: E402
from softsim_ros.messages import time_message  # noqa: E402
from softsim_ros.nodes.simulator import Simulator  # noqa: E402

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def seconds(state: JointState) -> float:
    return float(state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec)


def at(states: list[JointState], *positions: float) -> bool:
    return bool(states) and list(states[-1].position) == pytest.approx(positions, abs=1e-6)


def test_ros2_control_finds_the_robot_by_its_description_and_drives_it(tripod: Any, spin_until: Any) -> None:
    written = len(tripod.process.output)  # other tests have sent what is refused
    tripod.command([-0.1] * 3)
    descriptions = tripod.client.collect(String, "robot_description", LATCHED)
    assert spin_until(lambda: descriptions)
    control = ElementTree.fromstring(descriptions[0].data).find("ros2_control")
    topic = {each.get("name"): each.text for each in control.iter("param")}
    joints = [joint.get("name") for joint in control.iter("joint")]
    hardware = TopicHardware(
        tripod.client, joints, topic["joint_commands_topic"], topic["joint_states_topic"]
    )
    try:
        assert spin_until(lambda: hardware.states == pytest.approx(dict.fromkeys(joints, -0.1), abs=1e-6))
        before, sent = dict(hardware.states), hardware.sent
        assert spin_until(lambda: hardware.sent > sent + 20)  # all NaN: no controller is active
        assert hardware.states == pytest.approx(before, abs=1e-9)
        hardware.commands = {"servo_0": -0.4, "servo_1": -0.5, "servo_2": math.nan}
        wanted = {"servo_0": -0.4, "servo_1": -0.5, "servo_2": before["servo_2"]}
        assert spin_until(lambda: hardware.states == pytest.approx(wanted, abs=1e-6)), hardware.states
        hardware.commands["servo_2"] = -9.0  # beyond its limits
        assert spin_until(lambda: hardware.states["servo_2"] == pytest.approx(-2.0225, abs=1e-6))
        assert "joint command refused" not in tripod.process.output[written:]
    finally:
        hardware.close()


def test_commands_for_different_joints_add_up(tripod: Any, spin_until: Any) -> None:
    states = tripod.client.collect(JointState, "joint_states")
    tripod.command([-0.3] * 3)
    assert spin_until(lambda: at(states, -0.3, -0.3, -0.3))
    for name, value in (("servo_2", -0.6), ("servo_0", -0.5)):  # stamped 0: now
        tripod.client.publish("joint_commands", JointState(name=[name], position=[value]))
    assert spin_until(lambda: at(states, -0.5, -0.3, -0.6))


@pytest.mark.parametrize(
    ("message", "sentence"),
    [
        (JointState(name=["elbow"], position=[0.0]), "unknown joints elbow; known joints: servo_0"),
        (JointState(name=["servo_0"], velocity=[1.0]), "only positions are taken"),
        (
            JointState(header=Header(stamp=Time(sec=9)), name=["servo_0"], position=[-1.0]),
            "s ago, allowed are 0.5 s; use one clock",
        ),
    ],
)
def test_what_cannot_be_meant_is_refused(
    tripod: Any, spin_until: Any, message: JointState, sentence: str
) -> None:
    states = tripod.client.collect(JointState, "joint_states")

    def refused() -> bool:
        tripod.client.publish("joint_commands", message)
        return sentence in tripod.process.output

    assert spin_until(refused)
    assert spin_until(lambda: states)
    assert states[-1].position[0] != pytest.approx(-1.0)


def way_point(seconds: float, **values: list[float]) -> JointTrajectoryPoint:
    whole, part = divmod(seconds, 1.0)
    return JointTrajectoryPoint(time_from_start=Duration(sec=int(whole), nanosec=int(1e9 * part)), **values)


@pytest.fixture
def paused_simulator(ros_domain: int) -> Iterator[Simulator]:
    """A simulator in this process, which stands still, and stamps its messages with simulated time."""
    context = Context()
    context.init(args=["--ros-args", "--disable-rosout-logs"], domain_id=ros_domain)
    overrides = [Parameter("publish_clock", value=True), Parameter("backend", value="scipy")]
    simulator = Simulator("tripod", context=context, namespace="/stepped", parameter_overrides=overrides)
    simulator.physics.pause(True)
    try:
        with SpinThread([simulator], context):
            yield simulator
    finally:
        simulator.close()
        context.try_shutdown()


def test_a_trajectory_begins_at_its_stamp_and_keeps_its_velocities(
    paused_simulator: Simulator, client: Any, spin_until: Any
) -> None:
    states = client.collect(JointState, "/stepped/joint_states")
    physics = paused_simulator.physics

    def step() -> JointState:
        """The joints after one more step."""
        physics.step_once()
        assert spin_until(lambda: states and seconds(states[-1]) == pytest.approx(physics.status.time_s))
        return states[-1]

    def follows_a_command() -> bool:
        client.publish("/stepped/position_controller/commands", Float64MultiArray(data=[-0.5] * 3))
        step()
        return at(states, -0.5, -0.5, -0.5)

    assert spin_until(follows_a_command)
    begin = physics.status.time_s + 2.0
    points = [
        way_point(0.5, positions=[-0.8], velocities=[0.3]),  # on the way down it turns and comes up
        way_point(1.0, positions=[-0.5], velocities=[0.0]),
    ]
    message = JointTrajectory(joint_names=["servo_1"], points=points)
    message.header.stamp = time_message(begin)
    client.publish("/stepped/joint_trajectory", message)
    assert spin_until(lambda: step() and physics.status.trajectory)
    way = {}
    while physics.status.trajectory:
        state = step()
        way[seconds(state)] = state.position[1]
    first = min(time for time, position in way.items() if position != pytest.approx(-0.5, abs=1e-6))
    assert begin < first < begin + 2.5 * physics.status.dt
    assert min(way.values()) < -0.8  # passed by
    assert at([step()], -0.5, -0.5, -0.5)


@pytest.mark.parametrize(
    ("stamp", "point", "sentence"),
    [
        (9, way_point(1.0, positions=[-1.0]), "s ago and is over"),
        (2**31 - 1, way_point(1.0, positions=[-1.0]), "allowed are 3600"),
        (0, way_point(1.0, positions=[-1.0], velocities=[1.0]), "last way point must be 0"),
        (0, way_point(1.0, positions=[-1.0], effort=[1.0]), "efforts are not supported"),
        (0, way_point(1.0, positions=[-1.0], accelerations=[1.0]), "accelerations need velocities"),
    ],
)
def test_trajectories_that_cannot_be_followed_are_refused(
    tripod: Any, spin_until: Any, stamp: int, point: JointTrajectoryPoint, sentence: str
) -> None:
    header = Header(stamp=Time(sec=stamp))

    def refused() -> bool:
        message = JointTrajectory(header=header, joint_names=["servo_0"], points=[point])
        tripod.client.publish("joint_trajectory", message)
        return sentence in tripod.process.output

    assert spin_until(refused)
