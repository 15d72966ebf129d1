"""The maze on the robot: inverse control and path follower, each a process, lead the ball to its goal.

Exhaustive: commands carry no stamp, so that on a busy machine a step may go with the command of an earlier
goal, and the ball then may take another corridor. Each day `tests/analytic/test_maze_plan.py` leads the ball
in one process, and `tests/ros/test_paths_on_robot.py` the plate by these processes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("daqp")
pytest.importorskip("numba")
pytestmark = [pytest.mark.ros, pytest.mark.exhaustive, pytest.mark.numba]

from geometry_msgs.msg import Pose, PoseArray, PoseStamped  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import Float64, Float64MultiArray  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from softsim_core.physics.mechanics import rotation_of  # noqa: E402

GOAL = np.array([0.0252857, -0.0252857])
CORRIDOR = 0.0037143
"""Half the width of a corridor in [m]."""
DT = 0.01
"""Time step of the scene in [s]."""
GOAL_PERIOD_S = 0.02
"""The follower gives a goal this often, in simulated [s]."""
MOST_STEPS = 2000
"""Steps within which the plan of 11.5 s ends."""


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
    """The robot and its path follower."""
    robot = start_robot(robot="tripod_maze", publish_clock=True)
    inverse = start_process(
        "softsim_ros.nodes.inverse.inverse_node", "--ros-args", "-p", "robot:=tripod_maze"
    )
    assert inverse.says("ready to control", 180.0), inverse.output
    follower = start_process(
        "softsim_ros.nodes.inverse.path_follower_node",
        *("--ros-args", "-p", "robot:=tripod_maze", "-p", "file:=tripod_maze"),
        *("-p", "use_sim_time:=true"),
    )
    assert follower.says("call path_follower/start"), follower.output
    yield robot, follower
    for process in (follower, inverse, robot.process):
        assert process.end() == 0, process.output


def time_of(message: Any) -> float:
    """Simulated time of a message in [s]."""
    return float(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)


def test_the_ball_reaches_the_goal(
    maze: tuple[Any, Any], client: Any, spin_until: Callable[..., bool]
) -> None:
    """Step by step: the next one waits for the goal and the command of this one, however long they take."""
    robot, follower = maze
    states = client.collect(JointState, "joint_states")
    bodies = client.collect(PoseArray, "bodies/poses")
    progress = client.collect(Float64, "path_follower/progress")
    goals = client.collect(PoseStamped, "effector_goal")
    commands = client.collect(Float64MultiArray, "position_controller/commands")
    assert spin_until(lambda: states and bodies)
    assert robot.trigger("start")[0]
    assert spin_until(lambda: max(states[-1].position) < -1.49)
    assert spin_until(lambda: np.abs(states[-1].velocity).max() < 1e-6)
    np.testing.assert_allclose(ball_on_plate(bodies[-1])[:2], [-GOAL[0], GOAL[1]], atol=CORRIDOR)
    assert robot.pause(True)[0]
    answer = client.call(Trigger, "path_follower/start")
    assert answer.success, answer.message

    def is_over() -> bool:
        return bool(progress) and progress[-1].data == 100.0

    for _ in range(MOST_STEPS):
        before = time_of(states[-1])
        assert robot.trigger("step")[0]
        assert spin_until(lambda before=before: time_of(states[-1]) > before)
        if goals:
            due = time_of(states[-1]) - GOAL_PERIOD_S - 1.5 * DT
            assert spin_until(lambda due=due: is_over() or time_of(goals[-1]) > due), follower.output
            seen = len(commands)
            assert spin_until(lambda seen=seen: len(commands) > seen), follower.output
        if is_over():
            break
    assert is_over(), follower.output
    assert robot.pause(False)[0]

    def at_goal() -> bool:
        return bool((np.abs(ball_on_plate(bodies[-1])[:2] - GOAL) < CORRIDOR).all())

    assert spin_until(at_goal), ball_on_plate(bodies[-1])
    heights = np.array([ball_on_plate(each)[2] for each in bodies])
    assert heights.min() > 0.0019  # never through the floor
