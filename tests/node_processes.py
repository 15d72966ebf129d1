"""What the tests across processes have in common: waiting, node processes, a client."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from introductions import Introductions
from waiting import DEADLINE_S, spin_until

REPOSITORY = Path(__file__).resolve().parents[1]

WORKER = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
domains = deque(range(20 + WORKER, 100, int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))))
"""ROS domains of this worker in the order of their use: what a test left behind in one is not met by the next
test. A node that ends while another one is discovered may stay known to that one for ever."""
domain_guards: list[int] = []
"""File descriptors of the ports that stand for the ROS domains of the running test."""


@cache
def compiled_kernels() -> None:
    """Have robots run on compiled kernels from their start on, as all but the very first one do."""
    from softsim_core.simulation import kernels_ready

    if not kernels_ready():
        subprocess.run(
            [sys.executable, "-m", "softsim_core.simulation.warmup", "--small"], cwd=REPOSITORY, check=True
        )


SHARED_MEMORY = Path("/dev/shm")


def forget_killed_processes(domain: int) -> None:
    """Remove the mailboxes that killed processes left in the shared memory of a ROS domain that nobody uses.

    Fast DDS names them by its port numbers. One whose owner died over a message can swallow those to the next
    process that gets its number.
    """
    for port in range(7400 + 250 * domain, 7400 + 250 * (domain + 1)):
        for name in (f"fastrtps_port{port}", f"fastrtps_port{port}_el", f"sem.fastrtps_port{port}_mutex"):
            (SHARED_MEMORY / name).unlink(missing_ok=True)


@contextmanager
def reserved_domain() -> Iterator[int]:
    """Reserve a ROS domain that no other test on this machine uses now.

    A bound port stands for the domain. Processes of the test inherit it: one that outlives a killed test run
    keeps its domain, and disturbs nobody.
    """
    compiled_kernels()
    for _ in range(len(domains)):
        domain = domains[0]
        domains.rotate(-1)
        guard = socket.socket()
        try:
            guard.bind(("127.0.0.1", 47400 + domain))
        except OSError:
            guard.close()
            continue
        forget_killed_processes(domain)
        with guard:
            domain_guards.append(guard.fileno())
            yield domain
            domain_guards.remove(guard.fileno())
        return
    pytest.fail("no free ROS domain")


@contextmanager
def ros_environment(domain: int, folder: Path) -> Iterator[None]:
    """Set the environment of processes in a ROS domain; their logs and states go to `folder`."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(domain))
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        patch.setenv("ROS_LOG_DIR", str(folder / "log"))
        patch.setenv("XDG_STATE_HOME", str(folder / "state"))
        yield


@contextmanager
def private_ros(folder: Path) -> Iterator[int]:
    """Reserve a ROS domain and set it in the environment; logs go to `folder`."""
    with reserved_domain() as domain, ros_environment(domain, folder):
        yield domain


def hears_hang_up() -> None:
    """In a child: a hang-up counts, also where the tests themselves were started to outlive one."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


CRASHES = (signal.SIGSEGV, signal.SIGABRT, signal.SIGBUS, signal.SIGFPE, signal.SIGILL)
"""Signals by which a process ends that nobody ended."""


def resident_mb(pid: int) -> float:
    """Resident memory of a process in [MB]."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return float(line.split()[1]) * 1024 / 1e6
    raise AssertionError(f"process {pid} has ended")


def descendants(pid: int) -> list[int]:
    """The processes that a process has started, and those that they have."""
    found = []
    for file in Path(f"/proc/{pid}/task").glob("*/children"):
        with suppress(OSError):  # the thread has ended
            for child in map(int, file.read_text().split()):
                found += [child, *descendants(child)]
    return found


class NodeProcess:
    """A node in a process and session of its own; what it writes goes to a file."""

    def __init__(self, module: str, arguments: tuple[str, ...], log: Path) -> None:
        self._log, self.folder = log, log.parent
        self._shown_from = 0
        path = os.pathsep.join(
            filter(None, [str(REPOSITORY), os.environ.get("PYTHONPATH")])
        )  # apt's ROS, too
        with log.open("wb") as output:
            self.process = subprocess.Popen(
                [sys.executable, "-m", module, *arguments],
                cwd=log.parent,  # any folder will do: robots are found by name
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env={**os.environ, "PYTHONPATH": path, "PYTHONUNBUFFERED": "1", "PYTHONFAULTHANDLER": "1"},
                start_new_session=True,
                preexec_fn=hears_hang_up,
                pass_fds=list(domain_guards),
            )

    @property
    def output(self) -> str:
        """What it has written since its start, or since the last call of `forget_output`."""
        return self._log.read_bytes()[self._shown_from :].decode()

    def forget_output(self) -> None:
        """Leave out of `output` what it has written so far."""
        self._shown_from = self._log.stat().st_size

    @property
    def state(self) -> str:
        """Whether it runs, and what it has written."""
        code = self.process.poll()
        return f"[{'runs' if code is None else f'ended with {code}'}]\n{self.output}"

    def says(self, text: str, deadline_s: float = DEADLINE_S) -> bool:
        """Whether it writes `text` before the deadline (or has)."""
        spin_until(lambda: text in self.output or self.process.poll() is not None, deadline_s)
        return text in self.output

    def end(self, number: signal.Signals = signal.SIGINT, deadline_s: float = DEADLINE_S) -> int:
        """Send a signal and wait for the end of the process.

        Returns:
            The exit code.

        Raises:
            AssertionError: It did not end before the deadline. The process is ended with SIGABRT, on which
                Python's fault handler writes the stacks of all threads to the log that the message shows.
        """
        self.process.send_signal(number)
        try:
            return self.process.wait(deadline_s)
        except subprocess.TimeoutExpired:
            self.process.send_signal(signal.SIGABRT)
            with suppress(subprocess.TimeoutExpired):
                self.process.wait(DEADLINE_S)
        raise AssertionError(f"not ended {deadline_s:g} s after {number.name}; then SIGABRT: {self.state}")


def hung_in_middleware(output: str) -> bool:
    """Whether `softsim_node.process` ended a process that Fast DDS kept from ending; pytest shows a warning.

    Its main thread, the last one that the fault handler shows, was then taking the middleware down.
    """
    main = output.rpartition("Thread 0x")[2]
    cut_off = re.search(r"^Timeout \(\d+:\d\d:\d\d\)!$", output, re.MULTILINE)
    hung = cut_off is not None and ("in destroy_node" in main or "in try_shutdown" in main)
    if hung:
        warnings.warn(f"Fast DDS hung at the end of a process: {main}", stacklevel=2)
    return hung


class ProcessGroup:
    """Starts modules with command line arguments; what they write goes to files in `folder`.

    Args:
        folder: For the files.
        others: Processes that somebody else starts and ends, whose output is shown, too.
    """

    def __init__(self, folder: Path, others: Sequence[NodeProcess] = ()) -> None:
        self._folder, self._others = folder, others
        self._processes: list[NodeProcess] = []

    def __call__(self, module: str, *arguments: str) -> NodeProcess:
        log = self._folder / f"process_{len(self._processes)}.txt"
        self._processes.append(NodeProcess(module, arguments, log))
        return self._processes[-1]

    @property
    def output(self) -> str:
        """Whether each runs, and what it has written."""
        return "\n".join(process.state for process in (*self._others, *self._processes))

    def end(self) -> None:
        """End what still runs; each has to end in order, and none may have written a traceback."""
        try:
            for process in self._processes:
                if process.process.poll() is None:
                    assert process.end() == 0 or hung_in_middleware(process.output), process.output
                assert -process.process.returncode not in CRASHES, process.state
                assert "Traceback" not in process.output, process.output
        finally:
            for process in self._processes:
                process.process.kill()
                process.process.wait(DEADLINE_S)


DEPTH = 1000
"""Messages of a topic that may wait for a test that the machine has paused: of 100 Hz, those of 10 s."""
LOST_S = 20.0
"""A request without an answer for so long in [s] counts as lost on its way."""
NEWS_S = 0.05
"""Time in [s] that a process which is known gets to hear of a new client.

A request that overtakes this news is not answered, and no interface shows whether the other side has heard.
Where this time is too short, the request is repeated after `LOST_S`.
"""


class Answer:
    """The answer of a service; where none comes for long it is asked again, and pytest shows a warning.

    Args:
        ask: Sends the request; the future answer.
        name: Of the service.
    """

    def __init__(self, ask: Callable[[], Any], name: str) -> None:
        self._ask, self._name = ask, name
        self._futures = [ask()]
        self._asked = time.monotonic()

    def done(self) -> bool:
        """Whether an answer has come."""
        if any(each.done() for each in self._futures):
            return True
        if time.monotonic() - self._asked > LOST_S:
            warnings.warn(f"no answer from {self._name} for {LOST_S:g} s: asked again", stacklevel=2)
            self._futures.append(self._ask())
            self._asked = time.monotonic()
        return False

    def result(self) -> Any:
        """The first answer."""
        return next(each.result() for each in self._futures if each.done())


class Client:
    """A node of the test, served by a thread: collects messages, publishes, calls services.

    Args:
        domain: ROS domain.
        namespace: Namespace of the node.
        processes: Those it talks to; where none of them listens, what they wrote is shown.
    """

    def __init__(self, domain: int, namespace: str, processes: ProcessGroup | None = None) -> None:
        from rclpy.context import Context
        from rclpy.node import Node

        from softsim_ros import SpinThread

        self.context = Context()
        self.context.init(args=["--ros-args", "--disable-rosout-logs"], domain_id=domain)
        self.node = Node("client", context=self.context, namespace=namespace)
        self._spinner = SpinThread([self.node], self.context)
        self._spinner.__enter__()
        self._processes = processes
        self._clients: dict[str, Any] = {}
        self._publishers: dict[str, Any] = {}
        self._introductions = Introductions(self.node, lambda: self._written)

    def collect(self, message_type: Any, topic: str, qos: Any = DEPTH, *, raw: bool = False) -> list[Any]:
        """A list that grows with every message of a topic from now on."""
        messages: list[Any] = []
        self.node.create_subscription(message_type, topic, messages.append, qos, raw=raw)
        return messages

    def publisher(self, message_type: Any, topic: str, depth: int = 1) -> Any:
        """A publisher that all who are known to listen have met."""
        publisher = self.node.create_publisher(message_type, topic, depth)
        self._wait_for_listener(publisher)
        return publisher

    def publish(self, topic: str, message: Any) -> None:
        """Send a message once somebody listens, and all who are known to have been met."""
        if topic not in self._publishers:
            self._publishers[topic] = self.node.create_publisher(type(message), topic, 10)
        self._wait_for_listener(self._publishers[topic])
        self._publishers[topic].publish(message)

    def _wait_for_listener(self, publisher: Any) -> None:
        known = self.node.count_subscribers
        heard = spin_until(lambda: publisher.get_subscription_count() >= max(1, known(publisher.topic_name)))
        assert heard, f"nobody listens on {publisher.topic}{self._written}"

    @property
    def _written(self) -> str:
        """What those it talks to have written, below a line."""
        return "" if self._processes is None else f"\n{self._processes.output}"

    def call(self, service_type: Any, name: str, request: Any | None = None) -> Any:
        """The answer of a service."""
        answer = self.ask_service(service_type, name, request)
        assert spin_until(answer.done), f"no answer from {name}{self._written}"
        return answer.result()

    def ask_service(self, service_type: Any, name: str, request: Any | None = None) -> Answer:
        """Ask a service and do not wait."""
        service = self.service(service_type, name)
        return Answer(lambda: service.call_async(request or service_type.Request()), name)

    def service(self, service_type: Any, name: str) -> Any:
        """A client of a service that is there, whose process has found this one."""
        new = name not in self._clients
        if new:
            self._clients[name] = self.node.create_client(service_type, name)
        assert self._clients[name].wait_for_service(DEADLINE_S), f"no service {name}{self._written}"
        self._introductions.wait(self.node.resolve_service_name(name))
        if new:
            threading.Event().wait(NEWS_S)
        return self._clients[name]

    def action(self, action_type: Any, name: str) -> Any:
        """A client of an action that is there, whose process has found this one."""
        from rclpy.action import ActionClient

        client = ActionClient(self.node, action_type, name)
        assert client.wait_for_server(DEADLINE_S), f"no action {name}{self._written}"
        self._introductions.wait(f"{self.node.resolve_service_name(name)}/_action/send_goal")
        threading.Event().wait(NEWS_S)
        return client

    def in_turn(self, ask: Callable[[], Any]) -> Any:
        """What `ask` returns in the thread that serves the node.

        Rclpy's clients of actions drop an answer that another thread takes before the request is noted.
        """
        asked = self.node.executor.create_task(ask)
        assert spin_until(asked.done)
        return asked.result()

    def offered(self, node: str, namespace: str, *, services: bool = False) -> dict[str, list[str]]:
        """Types of what a node publishes (or of its services) by name, as far as the graph knows."""
        return self._introductions.offered(node, namespace, services=services)

    def close(self) -> None:
        self._spinner.close()
        self.node.destroy_node()
        self.context.try_shutdown()


def parameter_words(**values: object) -> list[str]:
    """The words of a command line that set ROS parameters."""
    texts = {name: str(value).lower() if isinstance(value, bool) else value for name, value in values.items()}
    return [word for name, text in texts.items() for word in ("-p", f"{name}:={text}")]
