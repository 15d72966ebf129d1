"""Goals of the tendon arm across processes: inverse control and simulator, in a ROS domain of their own."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from node_processes import Client
from shared_robots import SIMULATOR
from tendon_goals import HIGHEST, LOWEST, random_goals
from waiting import BUILD_S

pytest.importorskip("rclpy")
pytest.importorskip("daqp")
pytestmark = [pytest.mark.ros, pytest.mark.slow]

from geometry_msgs.msg import PoseStamped  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_srvs.srv import SetBool  # noqa: E402

from softsim_core import load_scene  # noqa: E402

ROBOT = "tendon_arm"


@pytest.fixture(scope="module")
def client(ros_domain: int, start_process: Callable[..., Any]) -> Iterator[Client]:
    """A node of the test in the arm's namespace."""
    node = Client(ros_domain, ROBOT)
    yield node
    node.close()


def test_goals_on_the_topic_are_reached_with_tensions_within_their_bounds(
    start_process: Callable[..., Any], client: Client, spin_until: Callable[..., bool]
) -> None:
    simulator = start_process(SIMULATOR, "--ros-args", "-p", f"robot:={ROBOT}")
    assert simulator.says("simulating", BUILD_S), simulator.output
    node = start_process("softsim_ros.nodes.inverse.inverse_node", "--ros-args", "-p", f"robot:={ROBOT}")
    assert node.says("ready to control", BUILD_S), node.output
    poses = client.collect(PoseStamped, "effector_pose", 5)

    def enabled() -> bool:
        return client.call(SetBool, "inverse_controller/enable", SetBool.Request(data=True)).success

    assert spin_until(enabled), node.output
    states, distances = client.collect(JointState, "joint_states", 100), []

    def distance(goal: np.ndarray) -> float:
        place = poses[-1].pose.position
        return float(np.linalg.norm(np.subtract((place.x, place.y, place.z), goal)))

    for goal in random_goals(load_scene(ROBOT, kind="robots"), 3):
        message = PoseStamped()
        message.header.frame_id = "world"
        place, message.pose.orientation.w = message.pose.position, 1.0
        place.x, place.y, place.z = goal.position.tolist()
        client.publish("effector_goal", message)
        assert spin_until(lambda at=goal.position: poses and distance(at) <= 0.5e-3, BUILD_S), node.output
        distances.append(distance(goal.position))
    tensions = np.array([state.effort for state in states])
    print(f"3 goals, worst {1e3 * max(distances):.3f} mm, {len(tensions)} steps, "
          f"{tensions.min():.3f} to {tensions.max():.3f} N")  # fmt: skip
    assert tensions.min() >= LOWEST
    assert tensions.max() <= HIGHEST
