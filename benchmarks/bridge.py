"""Measure latency from topic to wire and regularity of the servo bridge, at the far end of its line.

A virtual board receives the packets and records the time at which the last byte of each leaves the line: an
upper bound of the time at which it was written. Commands are sent at random times and alternate across the
edge of one degree byte, so that each of them changes the next packet that contains it.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from servo_bridge.driver import angle_to_byte, byte_to_angle
from servo_bridge.emulator import ReceivedPacket, VirtualBoard
from softsim_core import load_scene
from softsim_core.base import Array, SoftSimError, python_command, start_process
from softsim_core.scene import RobotDescription, ServoCalibration
from softsim_ros.cli.running import NODES

LATENCY_LIMIT_MS = 25.0
"""Largest 99th percentile from topic to last byte at 50 Hz, in [ms]: one period and the transport time."""

SECONDS = 20.0
PAUSE_S = (0.02, 0.05)
"""Shortest and longest time between two commands in [s]; each servo gets every third command."""

EDGE_BYTE = 130
BELOW_RAD, ABOVE_RAD = 5e-4, 5e-4
"""Distances of the poses from the edge in [rad].

They are equal: the last hundredths of a motion take one packet more, as the bridge brakes at its end, and the
edge must lie before them on the way back, too.
"""
START_DEADLINE_S = 180.0  # kernels may have to be compiled
END_DEADLINE_S = 20.0
NAMESPACE = "latency_check"
SEED = 1


class BridgeBenchmarkError(SoftSimError, RuntimeError):
    """A process of the measurement did not start or ended early; the text contains its last output."""


@dataclass(frozen=True)
class BridgeFigures:
    """Results at the far end of the line.

    Attributes:
        what: Description of the processes that ran.
        latency_ms: Time from topic to last byte of each command, in [ms], shape (k,).
        missed: Number of commands that no packet followed.
        periods_ms: Times between packets in [ms], shape (packets - 1,).
        period_ms: The requested period, in [ms].
    """

    what: str
    latency_ms: Array
    missed: int
    periods_ms: Array
    period_ms: float

    @property
    def late(self) -> bool:
        """Whether the 99th percentile is above `LATENCY_LIMIT_MS`, or commands were lost."""
        return self.missed > 0 or float(np.percentile(self.latency_ms, 99)) > LATENCY_LIMIT_MS

    def lines(self) -> list[str]:
        """Return the figures as text."""
        p50, p99, longest = np.percentile(self.latency_ms, (50, 99, 100))
        off = np.abs(self.periods_ms - self.period_ms)
        off50, off99, off100 = np.percentile(off, (50, 99, 100))
        return [
            self.what,
            f"  topic to last byte  p50 {p50:.1f}  p99 {p99:.1f}  max {longest:.1f} ms"
            f"  ({len(self.latency_ms)} commands, {self.missed} missed;"
            f" target p99 <= {LATENCY_LIMIT_MS:.0f} ms: {'MISSED' if self.late else 'ok'})",
            f"  send period         {self.periods_ms.mean():.3f} ms, off by  p50 {off50:.2f}  p99 {off99:.2f}"
            f"  max {off100:.2f} ms  ({len(self.periods_ms) + 1} packets)",
        ]


@dataclass(frozen=True, slots=True)
class Crossing:
    """A servo's angle crossed the edge of a byte at `time_s` of `time.monotonic`."""

    time_s: float
    servo: int
    servo_byte: int


def measure_bridge(robot: str = "tripod", seconds: float = SECONDS) -> list[BridgeFigures]:
    """Measure the bridge as a process of its own beside the simulator, then inside `softsim up`.

    The first uses the source `position_controller/commands` (from publication to last byte), the second
    mirrors `joint_states` (from their arrival at a subscriber to last byte).

    Raises:
        BridgeBenchmarkError: a process did not run.
        SceneError: the robot has no board.
    """
    scene = load_scene(robot)
    return [
        _measure(scene, seconds, "commands", "bridge beside the simulator, each a process, source commands"),
        _measure(scene, seconds, "joint_states", "softsim up: one process, source joint_states"),
    ]


def latencies(crossings: Sequence[Crossing], packets: Sequence[ReceivedPacket]) -> tuple[Array, int]:
    """Return the times in [ms] from each crossing to the first later packet with its byte.

    Also return the number of crossings without such a packet: those whose servo crossed again first.
    """
    found, missed = [], 0
    times = np.array([packet.time_s for packet in packets])
    for index, crossing in enumerate(crossings):
        following = (each.time_s for each in crossings[index + 1 :] if each.servo == crossing.servo)
        end = next(following, np.inf)
        first = int(np.searchsorted(times, crossing.time_s))
        for packet in packets[first:]:
            if packet.time_s >= end:
                missed += 1
                break
            if packet.servo_bytes[crossing.servo] == crossing.servo_byte:
                found.append(packet.time_s - crossing.time_s)
                break
    return np.array(found) * 1e3, missed


def _measure(robot: RobotDescription, seconds: float, source: str, what: str) -> BridgeFigures:
    domain = 60 + os.getpid() % 40  # separate from a running robot; domains up to 101 have free ports
    environment = os.environ | {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    assert robot.board is not None
    with (
        tempfile.TemporaryDirectory() as folder,
        VirtualBoard(len(robot.board.servos), link=Path(folder) / "board") as board,
        tempfile.TemporaryFile("w+") as log,
    ):
        environment["XDG_RUNTIME_DIR"] = folder
        commands = _programs(robot.name, board.port, source)
        with _running(commands, environment, log) as children, _Probe(robot, domain) as probe:
            settled = tuple(EDGE_BYTE for _ in robot.board.servos)
            _wait(lambda: probe.prepare() and board.servo_bytes == settled, children, log)
            crossings = probe.command_for(seconds, source)
            packets = board.packets
    if len(crossings) < 3 or len(packets) < 3:
        raise BridgeBenchmarkError(f"{what}: {len(crossings)} commands and {len(packets)} packets came")
    during = [packet for packet in packets if packet.time_s >= crossings[0].time_s]
    found, missed = latencies(crossings, during)
    periods = np.diff([packet.time_s for packet in during]) * 1e3
    return BridgeFigures(what, found, missed, periods, 1e3 / robot.board.rate)


def _programs(robot: str, port: str, source: str) -> list[list[str]]:
    """Return the command lines of the processes to measure."""
    if source == "joint_states":
        words = ["softsim_ros.cli", "up", robot, "--headless", "--send", "--board", port]
        return [[*words, "--namespace", NAMESPACE]]
    ros = ["--ros-args", "-r", f"__ns:=/{NAMESPACE}", "-p", f"robot:={robot}"]
    bridge = [f"port:={port}", f"source:={source}", "open_wait_s:=0.0", "autostart:=activate"]
    return [
        [NODES["simulator"].module, *ros],
        [NODES["servo_bridge"].module, *ros, *(word for setting in bridge for word in ("-p", setting))],
    ]


@contextmanager
def _running(
    commands: Sequence[Sequence[str]], environment: dict[str, str], log: IO[str]
) -> Iterator[list[subprocess.Popen[bytes]]]:
    """Run modules as processes of their own session; end them with Ctrl-C, then kill."""
    children = [
        start_process(
            python_command(module, *words),
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            env=environment,
            start_new_session=True,
        )
        for module, *words in commands
    ]
    try:
        yield children
    finally:
        for child in children:
            child.send_signal(signal.SIGINT)
        for child in children:
            try:
                child.wait(END_DEADLINE_S)
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()


def _wait(ready: Any, children: Sequence[subprocess.Popen[bytes]], log: IO[str]) -> None:
    """Wait until everything runs.

    Raises:
        BridgeBenchmarkError: a process ended, or the deadline passed.
    """
    deadline, nap = time.monotonic() + START_DEADLINE_S, threading.Event()
    while not ready():
        if time.monotonic() > deadline or any(child.poll() is not None for child in children):
            log.seek(0)
            raise BridgeBenchmarkError(f"the first pose was not reached: {log.read().strip()[-400:]}")
        nap.wait(0.05)


class _Probe:
    """Publishes commands across a byte's edge and records when they were published, or mirrored."""

    def __init__(self, robot: RobotDescription, domain: int) -> None:
        assert robot.board is not None
        self._servos = robot.board.hobby_servos
        self._order = [robot.joint_names.index(servo.joint) for servo in self._servos]
        self._values = [joint.limits.clamp(-1.0) for joint in robot.joints]
        self._domain = domain
        self._mirrored: list[Crossing] = []
        self._sides: list[int | None] = [None] * len(self._servos)
        for servo, index in zip(self._servos, self._order, strict=True):
            self._values[index] = _side(servo, above=True)

    def __enter__(self) -> _Probe:
        from rclpy.context import Context
        from rclpy.node import Node
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Float64MultiArray

        from softsim_node import NEWEST_ONLY
        from softsim_ros import SpinThread

        self._context = Context()
        self._context.init(args=["--ros-args", "--disable-rosout-logs"], domain_id=self._domain)
        self._node = Node("probe", context=self._context, namespace=NAMESPACE)
        self._message = Float64MultiArray
        self._publisher = self._node.create_publisher(
            Float64MultiArray, "position_controller/commands", NEWEST_ONLY
        )
        self._node.create_subscription(JointState, "joint_states", self._on_joint_states, 10)
        self._spinner = SpinThread([self._node], self._context)
        self._spinner.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._spinner.close()
        self._node.destroy_node()
        self._context.try_shutdown()

    def prepare(self) -> bool:
        """Command the first pose; return whether joint states arrive."""
        self._publish()
        return self._sides[0] is not None

    def command_for(self, seconds: float, source: str) -> list[Crossing]:
        """Send commands for some time; return the crossings of the source.

        Crossings before the first pose are left out.
        """
        randomness, nap = random.Random(SEED), threading.Event()
        self._mirrored.clear()
        published, above, end, turn = [], [True] * len(self._servos), time.monotonic() + seconds, 0
        while time.monotonic() < end:
            above[turn] = not above[turn]
            servo, index = self._servos[turn], self._order[turn]
            self._values[index] = _side(servo, above=above[turn])
            published.append(Crossing(time.monotonic(), turn, angle_to_byte(self._values[index], servo)))
            self._publish()
            turn = (turn + 1) % len(self._servos)
            nap.wait(randomness.uniform(*PAUSE_S))
        nap.wait(0.2)  # wait for messages in transit
        return published if source == "commands" else list(self._mirrored)

    def _publish(self) -> None:
        self._publisher.publish(self._message(data=self._values))

    def _on_joint_states(self, message: Any) -> None:
        now, positions = time.monotonic(), dict(zip(message.name, message.position, strict=True))
        for index, servo in enumerate(self._servos):
            side = angle_to_byte(positions[servo.joint], servo)
            if side != self._sides[index]:
                self._sides[index] = side
                self._mirrored.append(Crossing(now, index, side))


def _side(servo: ServoCalibration, *, above: bool) -> float:
    """Return an angle in [rad] just on one side of the edge between two servo bytes."""
    edge = byte_to_angle(EDGE_BYTE, servo)
    return edge + (servo.sign * ABOVE_RAD if above else -servo.sign * BELOW_RAD)
