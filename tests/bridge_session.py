"""What the tests of bridge and firmware share: bridge processes, a client of theirs, a stream of commands."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from node_processes import Answer, Client, ProcessGroup, parameter_words, spin_until

NAMESPACE = "/tripod"
BRIDGE = "servo_bridge.nodes.bridge_node"


class BridgeClient(Client):
    """A client in the robot's namespace that knows the bridge's services."""

    def __init__(self, domain: int, processes: ProcessGroup | None = None) -> None:
        super().__init__(domain, NAMESPACE, processes)

    def transition(self, label: str) -> None:
        """Have the bridge make a lifecycle transition."""
        assert self._change(label), f"{label} was refused{self._written}"

    def refuses(self, label: str) -> bool:
        """Whether the bridge refuses a lifecycle transition."""
        return not self._change(label)

    def _change(self, label: str) -> bool:
        answer = self.ask(label)
        assert spin_until(answer.done), f"no answer to {label}{self._written}"
        return bool(answer.result().success)

    def ask(self, label: str) -> Answer:
        """Ask for a lifecycle transition and do not wait."""
        from lifecycle_msgs.msg import Transition
        from lifecycle_msgs.srv import ChangeState

        number = getattr(Transition, f"TRANSITION_{label.upper()}")
        request = ChangeState.Request(transition=Transition(id=number))
        return self.ask_service(ChangeState, "servo_bridge/change_state", request)

    def state(self) -> str:
        """The bridge's lifecycle state."""
        from lifecycle_msgs.srv import GetState

        return str(self.call(GetState, "servo_bridge/get_state").current_state.label)

    def reaches(self, label: str) -> bool:
        """Whether the bridge comes into a state before the deadline; it changes after it has logged why."""
        return spin_until(lambda: self.state() == label)

    def trigger(self, service: str) -> Any:
        """Call a std_srvs/Trigger service."""
        from std_srvs.srv import Trigger

        return self.call(Trigger, service)


class BridgeHere:
    """A bridge in a thread of this process, beside a client; it logs to standard error.

    Args:
        client: Its context is the bridge's.
        log: The file that standard error goes to.
        parameters: The bridge's; it follows commands unless they say otherwise.
    """

    def __init__(self, client: BridgeClient, log: Path, parameters: Mapping[str, Any]) -> None:
        from rclpy.parameter import Parameter

        from servo_bridge.nodes import ServoBridge
        from softsim_ros import SpinThread

        values = {"source": "commands"} | {
            name: str(value) if isinstance(value, Path) else value for name, value in parameters.items()
        }
        self._log = log
        self.node = ServoBridge(
            context=client.context,
            namespace=NAMESPACE,
            parameter_overrides=[Parameter(name, value=value) for name, value in values.items()],
        )
        self._spinner: Any = SpinThread([self.node], client.context)
        self._spinner.__enter__()

    @property
    def output(self) -> str:
        """What was logged so far."""
        return self._log.read_text(errors="replace")

    def says(self, text: str) -> bool:
        """Whether it logs `text` before the deadline (or has)."""
        return spin_until(lambda: text in self.output)

    def end(self) -> None:
        """Close its port, with the servos at rest, and destroy it; a second call does nothing."""
        if self._spinner is not None:
            self.node.close()
            self._spinner.close()
            self.node.destroy_node()
            self._spinner = None


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
        """Publish no more; a second call does nothing."""
        self._stop.set()
        self._thread.join()


def bridge_words(**parameters: object) -> list[str]:
    """Command line of a bridge that follows commands; keywords are parameters."""
    values = {"source": "commands"} | parameters
    return ["--ros-args", "-r", f"__ns:={NAMESPACE}", *parameter_words(**values)]


@pytest.fixture
def client(ros_domain: int, start: ProcessGroup) -> Iterator[BridgeClient]:
    """A node of the test in the namespace of the robot."""
    made = BridgeClient(ros_domain, start)
    yield made
    made.close()


@pytest.fixture
def start(tmp_path: Path, ros_domain: int) -> Iterator[ProcessGroup]:
    """Starts `module` with command line arguments; whatever still runs at the end is ended and checked."""
    processes = ProcessGroup(tmp_path)
    yield processes
    processes.end()


@pytest.fixture
def stream() -> Iterator[Callable[[Any, Any], Stream]]:
    """Starts streams, which end with the test."""
    streams: list[Stream] = []

    def starter(publisher: Any, message: Any) -> Stream:
        streams.append(Stream(publisher, message))
        return streams[-1]

    yield starter
    for running in streams:
        running.stop()


@contextlib.contextmanager
def spinning(node: Any, context: Any) -> Iterator[None]:
    """Spin a node in a thread of this process; it is destroyed at the end."""
    from rclpy.executors import SingleThreadedExecutor  # absent without ROS

    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    stop = threading.Event()

    def spin() -> None:
        while not stop.is_set():
            executor.spin_once(timeout_sec=0.05)

    spinner = threading.Thread(target=spin)
    spinner.start()
    try:
        yield
    finally:
        stop.set()
        spinner.join()
        node.destroy_node()
        executor.shutdown()
