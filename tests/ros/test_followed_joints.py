"""A simulator whose arm goes where another one's joint states say, in another process."""

from __future__ import annotations

from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("urdf_parser_py")
pytestmark = [pytest.mark.ros, pytest.mark.slow]

from node_processes import Client, ProcessGroup  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import Float64MultiArray  # noqa: E402
from waiting import BUILD_S  # noqa: E402

from softsim_node import ParameterError  # noqa: E402
from softsim_ros.nodes.simulator import Simulator  # noqa: E402

SIMULATOR = "softsim_ros.nodes.simulator.simulator_node"
READY = [0.0, 0.4, 1.7, 0.0, 1.0416, 0.0, 0.0, 0.0, 0.0]


def test_the_arm_follows_and_the_gripper_is_commanded(
    start_process: ProcessGroup, ros_domain: int, spin_until: Any
) -> None:
    robot = start_process(
        SIMULATOR,
        *("--ros-args", "-p", "robot:=gripper_on_arm", "-p", "follow_joint_states:=/real_arm/joint_states"),
    )
    assert robot.says("simulating", BUILD_S), robot.output
    node = Client(ros_domain, "gripper_on_arm", start_process)
    try:
        states = node.collect(JointState, "joint_states")
        assert spin_until(lambda: states)
        node.publish("position_controller/commands", Float64MultiArray(data=[*READY[:6], 0.01, 0.01, 0.01]))
        told = JointState(name=["gripper_light", "base_yaw"], position=[7.0, 0.5])

        def there() -> bool:
            node.publish("/real_arm/joint_states", told)
            last = states[-1].position
            return abs(last[0] - 0.5) < 1e-9 and min(last[6:]) > 0.005

        assert spin_until(there), states[-1]
        assert states[-1].position[1] == pytest.approx(0.4)
    finally:
        node.close()
    assert robot.end() == 0


def test_its_own_joint_states_are_not_followed(ros_domain: int) -> None:
    context = Context()
    context.init(args=["--ros-args", "--disable-rosout-logs"], domain_id=ros_domain)
    overrides = [Parameter("follow_joint_states", value="joint_states"), Parameter("backend", value="scipy")]
    try:
        with pytest.raises(ParameterError, match="the simulator sends that itself"):
            Simulator("tripod", context=context, parameter_overrides=overrides)
    finally:
        context.try_shutdown()
