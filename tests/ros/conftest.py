"""Fixtures of the tests across processes: a ROS domain, node processes, a client with its own context."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
DEADLINE_S = 40.0
ANSWER_S = 4.0
BUILD_DEADLINE_S = 120.0  # kernels may have to be compiled
SIMULATOR = "softsim_ros.simulator.simulator_node"


def _spin_until(condition: Callable[[], Any], deadline_s: float = DEADLINE_S) -> bool:
    """Look at a condition until it holds; False when the deadline passed first."""
    end = time.monotonic() + deadline_s
    while not condition():
        if time.monotonic() > end:
            return False
        threading.Event().wait(0.005)
    return True


class NodeProcess:
    """A node in a process and session of its own; what it writes goes to a file."""

    def __init__(
        self, module: str, arguments: tuple[str, ...], environment: dict[str, str], log: Path
    ) -> None:
        self._log = log
        with log.open("wb") as output:
            self.process = subprocess.Popen(
                [sys.executable, "-m", module, *arguments],
                cwd=log.parent,  # any folder will do: robots are found by name
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=environment,
                start_new_session=True,
            )

    @property
    def output(self) -> str:
        return self._log.read_text()

    def says(self, text: str, deadline_s: float = DEADLINE_S) -> bool:
        """Whether it writes `text` before the deadline (or has)."""
        _spin_until(lambda: text in self.output or self.process.poll() is not None, deadline_s)
        return text in self.output

    def end(self, number: signal.Signals = signal.SIGINT) -> int:
        """Send a signal and wait; the exit code."""
        self.process.send_signal(number)
        return self.process.wait(DEADLINE_S)


class Client:
    """A node of the test, served by a thread: collects messages, publishes, calls services."""

    def __init__(self, domain: int, namespace: str) -> None:
        from rclpy.context import Context
        from rclpy.node import Node

        from softsim_ros.runtime import SpinThread

        self.context = Context()
        self.context.init(args=["--ros-args", "--disable-rosout-logs"], domain_id=domain)
        self.node = Node("client", context=self.context, namespace=namespace)
        self._spinner = SpinThread([self.node], self.context)
        self._spinner.__enter__()
        self._clients: dict[str, Any] = {}
        self._publishers: dict[str, Any] = {}

    def collect(self, message_type: Any, topic: str, qos: Any = 200, *, raw: bool = False) -> list[Any]:
        """A list that grows with every message of a topic from now on."""
        messages: list[Any] = []
        self.node.create_subscription(message_type, topic, messages.append, qos, raw=raw)
        return messages

    def publish(self, topic: str, message: Any) -> None:
        """Send a message once somebody listens."""
        if topic not in self._publishers:
            self._publishers[topic] = self.node.create_publisher(type(message), topic, 10)
        publisher = self._publishers[topic]
        assert _spin_until(lambda: publisher.get_subscription_count() > 0), f"nobody listens on {topic}"
        publisher.publish(message)

    def call(self, service_type: Any, name: str, request: Any | None = None, *, once: bool = False) -> Any:
        """The answer of a service.

        A service that has not found the reply reader of a new client yet loses its answer: the request is
        sent again after a while, unless it may only be carried out `once`.
        """
        if name not in self._clients:
            self._clients[name] = self.node.create_client(service_type, name)
        client = self._clients[name]
        assert client.wait_for_service(DEADLINE_S), f"no service {name}"
        request = request or service_type.Request()
        futures = [client.call_async(request)]
        patience = DEADLINE_S if once else ANSWER_S
        while not _spin_until(lambda: any(each.done() for each in futures), patience):
            assert len(futures) * patience < DEADLINE_S, f"no answer from {name}"
            futures.append(client.call_async(request))
        return next(each.result() for each in futures if each.done())

    def close(self) -> None:
        self._spinner.close()
        self.node.destroy_node()
        self.context.try_shutdown()


class Robot:
    """A simulator process seen through its topics and services."""

    def __init__(self, process: NodeProcess, client: Client) -> None:
        self.process, self.client = process, client

    def trigger(self, name: str) -> tuple[bool, str]:
        from std_srvs.srv import Trigger

        answer = self.client.call(Trigger, f"simulator/{name}", once=name == "step")
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
    for domain in range(50, 100):
        guard = socket.socket()
        try:
            guard.bind(("127.0.0.1", 47400 + domain))
        except OSError:
            guard.close()
            continue
        with guard, pytest.MonkeyPatch.context() as patch:
            patch.setenv("ROS_DOMAIN_ID", str(domain))
            patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
            patch.setenv("ROS_LOG_DIR", str(tmp_path_factory.mktemp("log")))
            patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
            yield domain
        return
    pytest.fail("no free ROS domain")


@pytest.fixture(scope="module")
def start_process(
    tmp_path_factory: pytest.TempPathFactory, ros_domain: int
) -> Iterator[Callable[..., NodeProcess]]:
    """Starts a module with command line arguments; what still runs at the end is ended and checked."""
    folder = tmp_path_factory.mktemp("processes")
    path = os.pathsep.join(filter(None, [str(REPOSITORY), os.environ.get("PYTHONPATH")]))
    environment = {**os.environ, "PYTHONPATH": path, "PYTHONUNBUFFERED": "1"}
    processes: list[NodeProcess] = []

    def start(module: str, *arguments: str) -> NodeProcess:
        processes.append(NodeProcess(module, arguments, environment, folder / f"{len(processes)}.txt"))
        return processes[-1]

    yield start
    try:
        for process in processes:
            if process.process.poll() is None:
                assert process.end() == 0, process.output
            assert "Traceback" not in process.output, process.output
    finally:
        for process in processes:
            process.process.kill()


@pytest.fixture(scope="module")
def client(ros_domain: int) -> Iterator[Client]:
    """A node of the test in the namespace of the robot."""
    node = Client(ros_domain, "tripod")
    yield node
    node.close()


@pytest.fixture(scope="module")
def start_robot(start_process: Callable[..., NodeProcess], client: Client) -> Callable[..., Robot]:
    """Starts a simulator; keywords are its parameters. Returns when it answers."""

    def start(**parameters: Any) -> Robot:
        arguments = [item for name, value in parameters.items() for item in ("-p", f"{name}:={_yaml(value)}")]
        process = start_process(SIMULATOR, "--ros-args", *arguments)
        assert process.says("simulating", BUILD_DEADLINE_S), process.output
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


def _yaml(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


@pytest.fixture(scope="session")
def spin_until() -> Callable[..., bool]:
    """Looks at a condition until it holds; False when the deadline passed first."""
    return _spin_until
