"""What the tests of bridge and firmware share: bridge processes, a client of theirs, a stream of commands."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from node_processes import DEADLINE_S, Client, NodeProcess, parameter_words, spin_until

NAMESPACE = "/tripod"
BRIDGE = "servo_bridge.bridge_node"
REACHED = {"configure": "inactive", "activate": "active", "deactivate": "inactive", "cleanup": "unconfigured"}


class BridgeClient(Client):
    """A client in the robot's namespace that knows the bridge's services."""

    def __init__(self, domain: int) -> None:
        super().__init__(domain, NAMESPACE)

    def publisher(self, kind: Any, topic: str) -> Any:
        """A publisher that has a subscriber."""
        publisher = self.node.create_publisher(kind, topic, 1)
        assert spin_until(lambda: publisher.get_subscription_count() > 0), f"nobody listens on {topic}"
        return publisher

    def transition(self, label: str) -> bool:
        """Ask the bridge for a lifecycle transition; whether it succeeded.

        A request that is sent again because its answer was lost is refused; the state tells then.
        """
        from lifecycle_msgs.msg import Transition
        from lifecycle_msgs.srv import ChangeState

        number = getattr(Transition, f"TRANSITION_{label.upper()}")
        request = ChangeState.Request(transition=Transition(id=number))
        answer = self.call(ChangeState, "servo_bridge/change_state", request)
        return bool(answer.success) or self.state() == REACHED.get(label, "finalized")

    def state(self) -> str:
        """The bridge's lifecycle state."""
        from lifecycle_msgs.srv import GetState

        return str(self.call(GetState, "servo_bridge/get_state").current_state.label)

    def trigger(self, service: str) -> Any:
        """Call a std_srvs/Trigger service."""
        from std_srvs.srv import Trigger

        return self.call(Trigger, service)


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
def client(ros_domain: int) -> Iterator[BridgeClient]:
    """A node of the test in the namespace of the robot."""
    made = BridgeClient(ros_domain)
    yield made
    made.close()


@pytest.fixture
def start(tmp_path: Path, ros_domain: int) -> Iterator[Callable[..., NodeProcess]]:
    """Starts `module` with command line arguments; whatever still runs at the end is ended and checked."""
    processes: list[NodeProcess] = []

    def starter(module: str, *arguments: str) -> NodeProcess:
        processes.append(NodeProcess(module, arguments, tmp_path / f"process_{len(processes)}.txt"))
        return processes[-1]

    yield starter
    try:
        for process in processes:
            if process.process.poll() is None:
                assert process.end() == 0, process.output
            assert "Traceback" not in process.output, process.output
    finally:
        for process in processes:
            process.process.kill()
            process.process.wait(DEADLINE_S)


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
