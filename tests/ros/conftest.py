"""Fixtures of the tests across processes: a ROS domain, node processes, a client, a simulator."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from node_processes import Client, NodeProcess, ProcessGroup, parameter_words, private_ros, ros_environment
from shared_robots import SIMULATOR, Robot, SharedRobot, SharedRobots
from waiting import BUILD_S, spin_until


@pytest.fixture(scope="session")
def shared_robots(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SharedRobots]:
    """Robots that run on for the tests of several files, each started when it is first asked for."""
    robots = SharedRobots(lambda: tmp_path_factory.mktemp("shared_robot"))
    yield robots
    robots.end()


@pytest.fixture(scope="module")
def shared_robot(request: pytest.FixtureRequest) -> Iterator[SharedRobot | None]:
    """The running robot that the module shares with others (its marker `shared_robot`), or None.

    It is paused between modules, where it would slow down the tests of other robots.
    """
    marker = request.node.get_closest_marker("shared_robot")
    if marker is None:
        yield None
        return
    pytest.importorskip("rclpy")
    robot = request.getfixturevalue("shared_robots").running(*marker.args)
    yield robot
    robot.check()


@pytest.fixture(scope="module")
def ros_domain(tmp_path_factory: pytest.TempPathFactory, shared_robot: SharedRobot | None) -> Iterator[int]:
    """The ROS domain of the module, in the environment of its tests.

    It is the domain of the shared robot, or one that no other test on this machine uses now.
    """
    pytest.importorskip("rclpy")
    folder = tmp_path_factory.mktemp("ros")
    if shared_robot is None:
        with private_ros(folder) as domain:
            yield domain
    else:
        with ros_environment(shared_robot.domain, folder):
            yield shared_robot.domain


@pytest.fixture(scope="module")
def start_process(
    tmp_path_factory: pytest.TempPathFactory, ros_domain: int, shared_robot: SharedRobot | None
) -> Iterator[ProcessGroup]:
    """Starts a module with command line arguments; what still runs at the end is ended and checked."""
    others = [] if shared_robot is None else [shared_robot.process]
    processes = ProcessGroup(tmp_path_factory.mktemp("processes"), others)
    yield processes
    processes.end()


@pytest.fixture(scope="module")
def client(
    ros_domain: int, start_process: ProcessGroup, shared_robot: SharedRobot | None
) -> Iterator[Client]:
    """A node of the test in the namespace of the robot."""
    node = Client(ros_domain, "tripod" if shared_robot is None else shared_robot.name, start_process)
    yield node
    node.close()


@pytest.fixture(scope="module")
def start_robot(start_process: Callable[..., NodeProcess], client: Client) -> Callable[..., Robot]:
    """Starts a simulator; keywords are its parameters. Returns when it answers."""

    def start(**parameters: Any) -> Robot:
        process = start_process(SIMULATOR, "--ros-args", *parameter_words(**parameters))
        assert process.says("simulating", BUILD_S), process.output
        return Robot(process, client)

    return start


@pytest.fixture(scope="module")
def running_tripod(
    request: pytest.FixtureRequest, shared_robot: SharedRobot | None, client: Client
) -> Iterator[Robot]:
    """One Tripod for the tests of a module: the shared one where the module has its marker, or its own."""
    if shared_robot is None:
        yield request.getfixturevalue("start_robot")()
        return
    robot = shared_robot.seen_by(client)
    robot.restore()
    yield robot
    assert robot.pause(True)[0]


@pytest.fixture
def tripod(running_tripod: Robot) -> Robot:
    """The module's Tripod, running, back at its start, with the parameters it was started with."""
    running_tripod.restore()
    return running_tripod


@pytest.fixture(scope="session", name="spin_until")
def _spin_until() -> Callable[..., bool]:
    """Looks at a condition until it holds; False when the deadline passed first."""
    return spin_until
