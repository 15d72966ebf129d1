"""The maze on the robot: inverse control and path follower, each a process, lead the ball to its goal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("daqp")
pytest.importorskip("numba")
pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.numba]

from geometry_msgs.msg import Pose, PoseArray  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import Float64  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from softsim_core.mechanics.pose import rotation_of  # noqa: E402

GOAL = np.array([0.0252857, -0.0252857])
CORRIDOR = 0.0037143
"""Half the width of a corridor in [m]."""
RUN_S = 120.0
"""Time for a plan of 11.5 s."""


def position(pose: Pose) -> np.ndarray:
    return np.array([pose.position.x, pose.position.y, pose.position.z])


def ball_on_plate(message: PoseArray) -> np.ndarray:
    """Centre of the ball in the plate's frame in [m], shape (3,)."""
    plate, ball = message.poses
    turn = plate.orientation
    rotation = rotation_of(np.array([turn.x, turn.y, turn.z, turn.w]))
    return rotation.T @ (position(ball) - position(plate))


@pytest.fixture
def maze(start_robot: Callable[..., Any], start_process: Callable[..., Any]) -> Iterator[tuple[Any, Any]]:
    """The robot and its path follower; a second try finds none of the first one's processes."""
    robot = start_robot(robot="tripod_maze", publish_clock=True)
    inverse = start_process("softsim_ros.inverse.inverse_node", "--ros-args", "-p", "robot:=tripod_maze")
    assert inverse.says("ready to control", 180.0), inverse.output
    follower = start_process(
        "softsim_ros.inverse.path_follower_node",
        *("--ros-args", "-p", "robot:=tripod_maze", "-p", "file:=tripod_maze"),
        *("-p", "use_sim_time:=true"),  # a slow machine plays the plan as slowly as it simulates
    )
    assert follower.says("call path_follower/start"), follower.output
    yield robot, follower
    for process in (follower, inverse, robot.process):
        assert process.end() == 0, process.output


def test_the_ball_reaches_the_goal(
    maze: tuple[Any, Any], client: Any, spin_until: Callable[..., bool]
) -> None:
    robot, follower = maze
    states = client.collect(JointState, "joint_states", 1)
    bodies = client.collect(PoseArray, "bodies/poses")
    progress = client.collect(Float64, "path_follower/progress")
    assert spin_until(lambda: states and bodies)
    assert robot.trigger("start")[0]
    assert spin_until(lambda: max(states[-1].position) < -1.49)
    assert spin_until(lambda: np.abs(states[-1].velocity).max() < 1e-6)
    np.testing.assert_allclose(ball_on_plate(bodies[-1])[:2], [-GOAL[0], GOAL[1]], atol=CORRIDOR)
    answer = client.call(Trigger, "path_follower/start")
    assert answer.success, answer.message
    assert spin_until(lambda: progress and progress[-1].data == 100.0, RUN_S), follower.output

    def at_goal() -> bool:
        return bool((np.abs(ball_on_plate(bodies[-1])[:2] - GOAL) < CORRIDOR).all())

    assert spin_until(at_goal), ball_on_plate(bodies[-1])
    heights = np.array([ball_on_plate(each)[2] for each in bodies])
    assert heights.min() > 0.0019  # never through the floor
