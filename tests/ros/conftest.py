"""Fixtures of the tests across processes: a ROS domain, node processes, a client, a simulator."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from node_processes import Client, NodeProcess, ProcessGroup, parameter_words, private_ros
from waiting import BUILD_S, spin_until

SIMULATOR = "softsim_ros.simulator.simulator_node"


class Robot:
    """A simulator process seen through its topics and services."""

    def __init__(self, process: NodeProcess, client: Client) -> None:
        self.process, self.client = process, client

    def trigger(self, name: str) -> tuple[bool, str]:
        from std_srvs.srv import Trigger

        answer = self.client.call(Trigger, f"simulator/{name}")
        return answer.success, answer.message

    def pause(self, paused: bool) -> tuple[bool, str]:
        from std_srvs.srv import SetBool

        answer = self.client.call(SetBool, "simulator/pause", SetBool.Request(data=paused))
        return answer.success, answer.message

    def command(self, values: list[float]) -> None:
        from std_msgs.msg import Float64MultiArray

        self.client.publish("position_controller/commands", Float64MultiArray(data=values))

    def set_parameters(self, **values: Any) -> tuple[bool, str]:
        from rcl_interfaces.srv import SetParametersAtomically
        from rclpy.parameter import Parameter

        messages = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        result = self.client.call(
            SetParametersAtomically,
            "simulator/set_parameters_atomically",
            SetParametersAtomically.Request(parameters=messages),
        ).result
        return result.successful, result.reason

    def get_parameter(self, name: str) -> Any:
        from rcl_interfaces.srv import GetParameters
        from rclpy.parameter import parameter_value_to_python

        values = self.client.call(
            GetParameters, "simulator/get_parameters", GetParameters.Request(names=[name])
        ).values
        return parameter_value_to_python(values[0])

    def warns(self, text: str) -> bool:
        return self.process.says(text)


@pytest.fixture(scope="module")
def ros_domain(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """A ROS domain that no other test on this machine uses now, in the environment of these tests."""
    pytest.importorskip("rclpy")
    with private_ros(tmp_path_factory.mktemp("ros")) as domain:
        yield domain


@pytest.fixture(scope="module")
def start_process(tmp_path_factory: pytest.TempPathFactory, ros_domain: int) -> Iterator[ProcessGroup]:
    """Starts a module with command line arguments; what still runs at the end is ended and checked."""
    processes = ProcessGroup(tmp_path_factory.mktemp("processes"))
    yield processes
    processes.end()


@pytest.fixture(scope="module")
def client(ros_domain: int, start_process: ProcessGroup) -> Iterator[Client]:
    """A node of the test in the namespace of the robot."""
    node = Client(ros_domain, "tripod", start_process)
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
def running_tripod(start_robot: Callable[..., Robot]) -> Robot:
    """One Tripod for the tests of a module."""
    return start_robot()


@pytest.fixture
def tripod(running_tripod: Robot) -> Robot:
    """The module's Tripod, running, back at its start, its physics as in its file."""
    assert running_tripod.pause(False)[0]
    tuned = {"young_modulus": 250.0e3, "poisson_ratio": 0.45, "enforce_limits": True, "speed": 1.0}
    assert running_tripod.set_parameters(**tuned) == (True, "")
    assert running_tripod.trigger("reset")[0]
    return running_tripod


@pytest.fixture(scope="session", name="spin_until")
def _spin_until() -> Callable[..., bool]:
    """Looks at a condition until it holds; False when the deadline passed first."""
    return spin_until
