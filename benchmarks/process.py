"""Measure memory of a simulator process, and the cost of publishing everything, from outside."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

from softsim_core import Simulation, load_scene
from softsim_core.base import SoftSimError, python_command, run_process, start_process
from softsim_ros.cli.running import NODES

MEMORY_LIMIT_MB = 400.0
"""Largest resident memory of the simulator process on the mid mesh, in [MB]."""

PUBLISH_LIMIT_MS = 2.0
"""Largest mean time per step to publish everything, on the mid mesh, in [ms]."""

STEPS = 1000
START_DEADLINE_S = 180.0  # kernels may have to be compiled
RUN_DEADLINE_S = 120.0
END_DEADLINE_S = 20.0
SETTLED_STEPS = 200
NODE_MODULE = NODES["simulator"].module
CHECKOUT = Path(__file__).resolve().parents[1]


class ProcessError(SoftSimError, RuntimeError):
    """The simulator process did not start, or ended early; the text contains its last output."""


@dataclass(frozen=True)
class ProcessFigures:
    """Resources that a process needed.

    Attributes:
        what: Description of the process.
        steps: Number of steps it had done.
        memory_mb: Resident memory then, in [MB].
        publish_ms: Mean time per step to publish, in [ms], the median over seconds; None without ROS.
        real_time_factor: Simulated over wall time, [-]; None without ROS.
    """

    what: str
    steps: int
    memory_mb: float
    publish_ms: float | None = None
    real_time_factor: float | None = None


def resident_mb(pid: int | str) -> float:
    """Return the resident memory of a process in [MB] (10^6 bytes).

    Raises:
        OSError: no such process, or no /proc.
    """
    for line in Path(f"/proc/{pid}/status").read_text(encoding="ascii", errors="replace").splitlines():
        if line.startswith("VmRSS:"):
            return float(line.split()[1]) * 1024.0 / 1e6
    return 0.0


def run_measurement(module: str, *words: str) -> subprocess.CompletedProcess[str]:
    """Run a module of this folder, which is not installed, in a process of its own; return its output."""
    search_path = os.pathsep.join(filter(None, (str(CHECKOUT), os.environ.get("PYTHONPATH"))))
    return run_process(
        python_command(module, *words),
        {**os.environ, "PYTHONPATH": search_path},
        capture_output=True,
        text=True,
    )


def measure_process(robot: str = "tripod_mid", steps: int = STEPS) -> ProcessFigures:
    """Run the simulator node with every topic subscribed; without ROS, a plain Simulation in its own process.

    Raises:
        ProcessError: it did not run.
    """
    try:
        import rclpy  # noqa: F401
        from diagnostic_msgs.msg import DiagnosticArray  # noqa: F401
    except ImportError:
        return _plain(robot, steps)
    return _node(robot, steps)


def _plain(robot: str, steps: int) -> ProcessFigures:
    child = run_measurement("benchmarks.process", robot, str(steps))
    if child.returncode != 0:
        raise ProcessError(f"the simulation process failed: {child.stderr.strip()[-400:]}")
    return ProcessFigures("Simulation in a process without ROS", steps, float(child.stdout))


def _node(robot: str, steps: int) -> ProcessFigures:
    domain = 60 + os.getpid() % 40  # separate from a running simulator; domains up to 101 have free ports
    environment = os.environ | {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    words = python_command(NODE_MODULE, "--ros-args")
    for setting in (f"robot:={robot}", "mesh_rate:=1000.0", "publish_clock:=true"):
        words += ["-p", setting]
    with tempfile.TemporaryFile("w+") as log:
        child = start_process(
            words, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=environment, start_new_session=True
        )
        try:
            with Listener(domain, f"/{load_scene(robot).name}") as listener:
                reports = wait_for_steps(child, listener, steps)
                memory = resident_mb(child.pid)
        except ProcessError as error:
            log.seek(0)
            raise ProcessError(f"{error}; it said: {log.read().strip()[-400:]}") from None
        finally:
            end_process(child)
    settled = [each for each in reports if each["steps"] >= SETTLED_STEPS] or reports
    return ProcessFigures(
        "simulator node, every topic subscribed, mesh each step",
        int(reports[-1]["steps"]),
        memory,
        median(each["publishing_ms"] for each in settled),
        median(each["real_time_factor"] for each in settled),
    )


def wait_for_steps(child: subprocess.Popen[bytes], listener: Listener, steps: int) -> list[dict[str, float]]:
    """Return the diagnostics of the node until it has done `steps` steps.

    Raises:
        ProcessError: it ended, or makes no progress.
    """
    deadline = time.monotonic() + START_DEADLINE_S
    while not listener.reports or listener.reports[-1]["steps"] < steps:
        if child.poll() is not None:
            raise ProcessError(f"the simulator ended with exit code {child.returncode}")
        if time.monotonic() > deadline:
            raise ProcessError("the simulator did not get on")
        if len(listener.reports) == 1:
            deadline = time.monotonic() + RUN_DEADLINE_S
        listener.news.wait(0.5)
        listener.news.clear()
    return list(listener.reports)


def end_process(child: subprocess.Popen[bytes]) -> None:
    """End a node in its own session with Ctrl-C, then kill."""
    if child.poll() is None:
        child.send_signal(signal.SIGINT)
        try:
            child.wait(END_DEADLINE_S)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()


class Listener:
    """Stores the values of a simulator's diagnostics; with `everything`, subscribes to its topics, too."""

    def __init__(self, domain: int, namespace: str, *, everything: bool = True) -> None:
        self._everything = everything
        self.reports: list[dict[str, float]] = []
        self.news = threading.Event()
        self._domain, self._namespace = domain, namespace

    def __enter__(self) -> Listener:
        """Start listening."""
        from diagnostic_msgs.msg import DiagnosticArray
        from geometry_msgs.msg import PoseStamped
        from rclpy.context import Context
        from rclpy.node import Node
        from rosgraph_msgs.msg import Clock
        from sensor_msgs.msg import JointState, PointCloud2
        from shape_msgs.msg import Mesh
        from visualization_msgs.msg import Marker

        from softsim_node import LATCHED
        from softsim_ros import SpinThread, optional_type

        self._context = Context()
        self._context.init(args=["--ros-args", "--disable-rosout-logs"], domain_id=self._domain)
        self._node = Node("benchmark", context=self._context, namespace=self._namespace)
        topics: list[tuple[Any, str, Any]] = [
            (JointState, "joint_states", 10),
            (PoseStamped, "effector_pose", 5),
            (PointCloud2, "mesh/points", 1),
            (Marker, "mesh/marker", 1),
            (Mesh, "mesh/topology", LATCHED),
            (Clock, "/clock", 1),
        ]
        transforms = optional_type("tf2_msgs.msg", "TFMessage")
        if transforms is not None:
            topics.append((transforms, "/tf", 100))
        for kind, name, quality in topics if self._everything else ():
            self._node.create_subscription(kind, name, _ignore, quality, raw=True)
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self._spinner = SpinThread([self._node], self._context)
        self._spinner.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop listening."""
        self._spinner.close()
        self._node.destroy_node()
        self._context.try_shutdown()

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            numbers = {}
            for entry in status.values:
                try:
                    numbers[entry.key] = float(entry.value)
                except ValueError:
                    continue
            if {"steps", "publishing_ms", "real_time_factor"} <= numbers.keys():
                self.reports.append(numbers)
                self.news.set()


def _ignore(_: bytes) -> None:
    """Ignore the message, which only has to be received."""


def main(words: list[str]) -> int:
    """Step a robot some times, then write this process's memory in [MB]; the words are ROBOT STEPS."""
    simulation = Simulation(load_scene(words[0]))
    for _ in range(int(words[1])):
        simulation.step()
    sys.stdout.write(f"{resident_mb('self')}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
