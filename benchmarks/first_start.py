"""Measure the first start of a fresh checkout, with empty environment and caches, phase by phase."""

from __future__ import annotations

import contextlib
import math
import os
import re
import shutil
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

from softsim_core.base import start_process

MOTION_WITHIN_S: Final = 45.0
KERNELS_WITHIN_S: Final = 90.0
"""Targets on an idle machine with two cores, from the command to the first motion and to the kernels."""

SLOWEST_FACTOR: Final = 0.9
"""Target for the real-time factor from the first motion until compiled kernels run, in each second, [-]."""

REPORTED_S: Final = 1.5
"""Longest interval in [s] that a report of the simulator covers: earlier ones may begin before the motion."""

MOTION, KERNELS = "first motion is published", "compiled kernels run"

COMMANDED_RAD, MOVED_RAD = 0.3, 1e-3
END_WITHIN_S: Final = 30.0
INSTALL_WITHIN_S: Final = 900.0
"""Time limit in [s] of the whole start."""

LEFT_OUT: Final = (".git", ".softsim*", "__pycache__", ".*_cache", "*.egg-info", "build")
FORGOTTEN: Final = (
    "PYTHONPATH", "VIRTUAL_ENV", "SOFTSIM_HOME", "NUMBA_CACHE_DIR", "AMENT_PREFIX_PATH", "LD_LIBRARY_PATH",
    "_ROS_WHEELS_BOOTSTRAP_COMPLETE", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
)  # fmt: skip

_LINES: Final = (  # line of the command's output -> the phase that has ended then
    (re.compile(r"^\[\d/\d\] ([^:]+): done"), None),
    (re.compile(r"^starting "), "the program has started"),
    (re.compile(r"\]: simulating "), "the simulator runs"),
    (re.compile(r"\]: kernels compiled: "), KERNELS),
)


class FirstStart:
    """Starts the copy and records when each phase has ended.

    Args:
        checkout: Folder to copy.
        robot: Robot to start.
        say: Called with a message about each phase and its time when it has ended.

    Attributes:
        phases: When each ended, since the command was given, in [s].
        factors: Real-time factor of each second from the first motion until compiled kernels ran, [-].
        output: Lines of its output.
    """

    def __init__(self, checkout: Path, robot: str, say: Callable[[str], None]) -> None:
        self._checkout, self._robot, self._say = checkout, robot, say
        self._began = 0.0
        self._news = threading.Condition()
        self.phases: dict[str, float] = {}
        self.factors: list[float] = []
        self.output: list[str] = []

    def run(self, within_s: float) -> int | None:
        """Start, wait until compiled kernels run, end; return the exit code, or None if time ran out."""
        with tempfile.TemporaryDirectory(prefix="softsim-first-") as folder, contextlib.ExitStack() as stack:
            copy = Path(folder) / "checkout"
            shutil.copytree(self._checkout, copy, symlinks=True, ignore=shutil.ignore_patterns(*LEFT_OUT))
            domain = 1 + os.getpid() % 100
            self._began = time.monotonic()
            process = start_process(
                ["./softsim", "up", self._robot, "--headless", "--port", str(_free_port())],
                cwd=copy,
                env=_environment(Path(folder), domain),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                start_new_session=True,
            )
            stack.callback(_end, process)
            reader = threading.Thread(target=self._read, args=(process,), daemon=True)
            reader.start()
            stack.enter_context(self._watching(domain))
            with self._news:
                self._news.wait_for(lambda: KERNELS in self.phases or not reader.is_alive(), within_s)
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
            with contextlib.suppress(subprocess.TimeoutExpired):
                code = process.wait(END_WITHIN_S)
                return code if code or KERNELS in self.phases else None
            return None

    def _read(self, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        for line in process.stdout:
            self.output.append(line.rstrip())
            for pattern, phase in _LINES:
                if found := pattern.search(line):
                    self._record_phase(phase or re.sub(r" (in /|\().*", "", found[1]))
        with self._news:
            self._news.notify_all()

    def _record_phase(self, phase: str) -> None:
        with self._news:
            if phase not in self.phases:
                self.phases[phase] = time.monotonic() - self._began
                self._say(f"{self.phases[phase]:7.1f} s  {phase}")
            self._news.notify_all()

    @contextlib.contextmanager
    def _watching(self, domain: int) -> Iterator[None]:
        """Command the joints as soon as their states arrive, and record when and how fast.

        Do nothing without ROS.
        """
        try:
            from diagnostic_msgs.msg import DiagnosticArray
            from rclpy.context import Context
            from rclpy.executors import SingleThreadedExecutor
            from rclpy.node import Node
            from sensor_msgs.msg import JointState
            from std_msgs.msg import Float64MultiArray
        except ImportError:
            yield
            return
        context = Context()
        context.init(args=["--ros-args", "--disable-rosout-logs"], domain_id=domain)
        node = Node("_softsim_watch", context=context, use_global_arguments=False, enable_rosout=False)
        first: list[float] = []
        topic = f"/{self._robot}/position_controller/commands"
        commands = node.create_publisher(Float64MultiArray, topic, 10)

        def look(message: JointState) -> None:
            now = [*message.position]
            first.extend(now if not first else ())
            if MOTION not in self.phases:
                commands.publish(Float64MultiArray(data=[each - COMMANDED_RAD for each in first]))
            if max((abs(a - b) for a, b in zip(now, first, strict=False)), default=0.0) > MOVED_RAD:
                self._record_phase(MOTION)
                has_moved.set()

        def note(message: DiagnosticArray) -> None:
            moved = self.phases.get(MOTION, math.inf)
            if time.monotonic() - self._began > moved + REPORTED_S and KERNELS not in self.phases:
                values = [entry for status in message.status for entry in status.values]
                self.factors += [float(each.value) for each in values if each.key == "real_time_factor"]

        joints = node.create_subscription(JointState, f"/{self._robot}/joint_states", look, 10)
        node.create_subscription(DiagnosticArray, "/diagnostics", note, 10)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        over, has_moved = threading.Event(), threading.Event()

        def spin() -> None:
            while not over.is_set():
                executor.spin_once(timeout_sec=0.1)
                if has_moved.is_set():  # receiving them takes a tenth of a core away from the measurement
                    has_moved.clear()
                    node.destroy_subscription(joints)

        thread = threading.Thread(target=spin, daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()
            executor.shutdown()
            node.destroy_node()
            context.try_shutdown()


def compare_with_targets(phases: Mapping[str, float], factors: Sequence[float]) -> tuple[list[str], int]:
    """Return a message on each target, and the number of missed ones.

    Factors are those of FirstStart; they are not judged if there are none.
    """
    lines, missed = [], 0
    for phase, target in ((MOTION, MOTION_WITHIN_S), (KERNELS, KERNELS_WITHIN_S)):
        seconds = phases.get(phase, math.inf)
        missed += seconds > target
        when = f"after {seconds:.1f} s" if seconds < math.inf else "not seen"
        lines.append(f"{phase}: {when}, target {target:g} s: {_verdict(seconds <= target)}")
    if factors:
        slowest, median = min(factors), statistics.median(factors)
        missed += slowest < SLOWEST_FACTOR
        lines.append(
            f"real-time factor until then: {slowest:.2f} in the slowest second, median {median:.2f},"
            f" target {SLOWEST_FACTOR:g}: {_verdict(slowest >= SLOWEST_FACTOR)}"
        )
    return lines, missed


def _verdict(met: bool) -> str:
    return "as wanted" if met else "missed; it is meant for an idle machine"


def _environment(folder: Path, domain: int) -> dict[str, str]:
    """Return this process's environment without its Python environment, and with empty caches."""
    variables = {name: value for name, value in os.environ.items() if name not in FORGOTTEN}
    own = [str(Path(sys.prefix) / "bin")]
    path = [each for each in variables.get("PATH", "").split(os.pathsep) if each not in own]
    caches = ("UV_CACHE_DIR", "PIP_CACHE_DIR", "XDG_CACHE_HOME", "XDG_RUNTIME_DIR")
    for name in caches:
        (folder / name).mkdir(mode=0o700)
    return {
        **variables,
        "PATH": os.pathsep.join(path),
        **{name: str(folder / name) for name in caches},
        "SOFTSIM_PYTHON": str(Path(sys.base_prefix) / "bin" / f"python3.{sys.version_info.minor}"),
        "ROS_DOMAIN_ID": str(domain),
        "PYTHONUNBUFFERED": "1",
    }


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _end(process: subprocess.Popen[str]) -> None:
    if process.poll() is None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
