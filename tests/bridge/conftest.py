"""Fixtures of the bridge's tests: virtual board, bridge processes, a ROS client on a domain of its own."""

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

from servo_bridge.virtual_board import VirtualBoard

REPOSITORY = Path(__file__).resolve().parents[2]
DEADLINE_S = 15.0
NAMESPACE = "/tripod"


def _wait_until(condition: Callable[[], bool], deadline_s: float = DEADLINE_S) -> bool:
    """Poll a condition that has no event of its own; False when the deadline passed."""
    end = time.monotonic() + deadline_s
    while not condition():
        if time.monotonic() > end:
            return False
        threading.Event().wait(0.01)
    return True


@pytest.fixture
def wait_until() -> Callable[..., bool]:
    return _wait_until


@pytest.fixture(autouse=True)
def no_calibration_of_this_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "configuration"))


@pytest.fixture
def board(tmp_path: Path) -> Iterator[VirtualBoard]:
    with VirtualBoard(link=tmp_path / "board") as virtual:
        yield virtual


@pytest.fixture
def ros_domain(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A ROS domain that no other test on this machine uses now, in the environment of this test."""
    pytest.importorskip("rclpy")
    for domain in range(10, 50):
        guard = socket.socket()
        try:
            guard.bind(("127.0.0.1", 47400 + domain))
        except OSError:
            guard.close()
            continue
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "log"))
        yield domain
        guard.close()
        return
    pytest.fail("no free ROS domain")


class Process:
    """A node in a process and session of its own; what it writes goes to files."""

    def __init__(self, module: str, folder: Path, number: int, *arguments: str) -> None:
        self._output = folder / f"{module}_{number}.txt"
        paths = [
            str(REPOSITORY),
            *filter(None, [os.environ.get("PYTHONPATH")]),
        ]  # apt's ROS lives on that path
        with self._output.open("wb") as output:
            self.process = subprocess.Popen(
                [sys.executable, "-m", module, *arguments],
                cwd=REPOSITORY,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env={**os.environ, "PYTHONPATH": os.pathsep.join(paths), "PYTHONUNBUFFERED": "1"},
                start_new_session=True,
            )

    @property
    def output(self) -> str:
        return self._output.read_text()

    def says(self, text: str) -> bool:
        """Wait until the process has written `text`."""
        return _wait_until(lambda: text in self.output)

    def end(self, number: signal.Signals = signal.SIGINT) -> int:
        """Send a signal and wait; the exit code."""
        self.process.send_signal(number)
        return self.process.wait(DEADLINE_S)


@pytest.fixture
def start(tmp_path: Path, ros_domain: int) -> Iterator[Callable[..., Process]]:
    """Starts `module` with command line arguments; whatever still runs at the end is ended and checked."""
    processes: list[Process] = []

    def starter(module: str, *arguments: str) -> Process:
        processes.append(Process(module, tmp_path, len(processes), *arguments))
        return processes[-1]

    yield starter
    for process in processes:
        if process.process.poll() is None:
            try:
                assert process.end() == 0, process.output
            finally:
                process.process.kill()
        assert "Traceback" not in process.output, process.output


@pytest.fixture
def start_bridge(start: Callable[..., Process], board: VirtualBoard) -> Callable[..., Process]:
    """Starts the bridge on the virtual board; keywords are parameters (quiet time 0, source commands)."""

    def starter(**parameters: object) -> Process:
        values = {"port": board.port, "source": "commands", "open_wait_s": 0.0} | parameters
        arguments = [item for name, value in values.items() for item in ("-p", f"{name}:={_yaml(value)}")]
        return start("servo_bridge.bridge_node", "--ros-args", "-r", f"__ns:={NAMESPACE}", *arguments)

    return starter


def _yaml(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


class Client:
    """A ROS node of the test, spun in a thread: publishes, collects messages, calls services."""

    def __init__(self, domain: int) -> None:
        from rclpy.context import Context
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node

        self.context = Context()
        self.context.init(domain_id=domain)
        self.node = Node("tester", context=self.context, namespace=NAMESPACE)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._spin)
        self._thread.start()

    def _spin(self) -> None:
        while not self._stop.is_set():
            self._executor.spin_once(timeout_sec=0.05)

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.node.destroy_node()
        self._executor.shutdown()
        self.context.try_shutdown()

    def collect(self, kind: Any, topic: str) -> list[Any]:
        """A list that fills with the messages of a topic."""
        messages: list[Any] = []
        self.node.create_subscription(kind, topic, messages.append, 10)
        return messages

    def publisher(self, kind: Any, topic: str) -> Any:
        """A publisher that has a subscriber."""
        publisher = self.node.create_publisher(kind, topic, 1)
        assert _wait_until(lambda: publisher.get_subscription_count() > 0), f"nobody listens to {topic}"
        return publisher

    def call(self, kind: Any, service: str, request: Any) -> Any:
        """The answer of a service."""
        client = self.node.create_client(kind, service)
        assert _wait_until(client.service_is_ready), f"no service {service}"
        future = client.call_async(request)
        assert _wait_until(future.done), f"no answer from {service}"
        return future.result()

    def transition(self, label: str) -> bool:
        """Ask the bridge for a lifecycle transition; whether it succeeded."""
        from lifecycle_msgs.msg import Transition
        from lifecycle_msgs.srv import ChangeState

        number = getattr(Transition, f"TRANSITION_{label.upper()}")
        request = ChangeState.Request(transition=Transition(id=number))
        return bool(self.call(ChangeState, "servo_bridge/change_state", request).success)

    def state(self) -> str:
        """The bridge's lifecycle state."""
        from lifecycle_msgs.srv import GetState

        return str(self.call(GetState, "servo_bridge/get_state", GetState.Request()).current_state.label)

    def trigger(self, service: str) -> Any:
        """Call a std_srvs/Trigger service."""
        from std_srvs.srv import Trigger

        return self.call(Trigger, service, Trigger.Request())


@pytest.fixture
def client(ros_domain: int) -> Iterator[Client]:
    made = Client(ros_domain)
    yield made
    made.close()


class Stream:
    """Publishes the newest message at 50 Hz from a thread, as a controller does."""

    def __init__(self, publisher: Any, message: Any) -> None:
        self.message = message
        self._publisher = publisher
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.wait(0.02):
            self._publisher.publish(self.message)

    def stop(self) -> None:
        self._stop.set()
        self._thread.join()


@pytest.fixture
def stream() -> Iterator[Callable[..., Stream]]:
    streams: list[Stream] = []

    def starter(publisher: Any, message: Any) -> Stream:
        streams.append(Stream(publisher, message))
        return streams[-1]

    yield starter
    for running in streams:
        running.stop()
