"""The teleop in a real terminal against real ROS peers: typed keys become commands, every exit is clean."""

from __future__ import annotations

import os
import re
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from node_processes import NodeProcess, private_ros
from terminal_session import TerminalSession
from waiting import BUILD_S, DEADLINE_S

pytest.importorskip("rclpy")

from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from servo_bridge.emulator import VirtualBoard
from softsim_ros.keys import HOLD_GAP_S
from softsim_ros.nodes.teleop import main

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("ros_domain")]

JOINTS = ["servo_0", "servo_1", "servo_2"]
START = (-3.14 / 3,) * 3  # the pose mid: a command to go there and the measured positions agree
TELEOP = [sys.executable, "-m", "softsim_ros.nodes.teleop.teleop_node"]


class Robot:
    """A robot of ideal servos: each command is reached at once and published as joint_states at 50 Hz."""

    def __init__(self, context: Context, namespace: str, joints: list[str], receives: bool = True) -> None:
        self.node = Node("robot", context=context, namespace=namespace)
        self.joints, self.positions = joints, list(START)
        self.received: list[tuple[float, ...]] = []
        self._changed = threading.Condition()
        self._states = self.node.create_publisher(JointState, "joint_states", 10)
        if receives:
            self.receive()
        self.node.create_timer(0.02, self._publish)

    def receive(self) -> None:
        """Subscribe to commands."""
        self.node.create_subscription(
            Float64MultiArray, "position_controller/commands", self._on_command, QoSProfile(depth=1)
        )

    def _publish(self) -> None:
        self._states.publish(JointState(name=self.joints, position=self.positions))

    def _on_command(self, message: Float64MultiArray) -> None:
        with self._changed:
            self.positions = list(message.data)
            self.received.append(tuple(message.data))
            self._changed.notify_all()

    def is_found_by(self, session: TerminalSession, key: bytes) -> bool:
        """Type a key until its command comes: nothing is commanded before both have found each other."""
        return any(self.obeys(session, key) for _ in range(int(DEADLINE_S)))

    def obeys(self, session: TerminalSession, key: bytes) -> bool:
        """Type a key; whether a command comes within a second."""
        session.type(key)
        with self._changed:
            return self._changed.wait_for(lambda: bool(self.received), 1.0)

    def wait_for_commands(self, count: int) -> list[tuple[float, ...]]:
        """The first `count` commands; fails when they do not come."""
        with self._changed:
            assert self._changed.wait_for(lambda: len(self.received) >= count, DEADLINE_S), self.received
            return self.received[:count]


@contextmanager
def running_robot(
    namespace: str = "tripod", joints: list[str] = JOINTS, receives: bool = True
) -> Iterator[Robot]:
    context = Context()
    context.init()
    robot = Robot(context, namespace, joints, receives)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(robot.node)
    stop = threading.Event()

    def spin() -> None:
        while not stop.is_set():
            try:
                executor.spin_once(timeout_sec=0.05)
            except (ExternalShutdownException, ShutdownException):
                return

    thread = threading.Thread(target=spin)
    thread.start()
    try:
        yield robot
    finally:
        stop.set()
        thread.join()
        robot.node.destroy_node()
        context.try_shutdown()


@pytest.fixture(scope="module")
def running(ros_domain: int) -> Iterator[tuple[Robot, TerminalSession]]:
    """One robot and one teleop for the tests of the module; Ctrl+C ends it."""
    with running_robot() as peer, TerminalSession(TELEOP) as session:
        session.wait_for("simulator: running")
        assert peer.is_found_by(session, b"q"), session.screen
        yield peer, session
        session.type(b"\x03")
        quits_cleanly(session)


@pytest.fixture
def robot(running: tuple[Robot, TerminalSession]) -> Robot:
    """The robot at its start, as the teleop shows it."""
    peer, session = running
    peer.joints, peer.positions = JOINTS, list(START)
    session.wait_for("simulator: running")
    assert session.wait_until(lambda: all(f"{each:.4f}" in session.screen for each in START)), session.screen
    peer.received.clear()
    return peer


@pytest.fixture
def teleop(running: tuple[Robot, TerminalSession]) -> TerminalSession:
    return running[1]


def started_bridge(folder: Path, namespace: str, *arguments: str) -> NodeProcess:
    """A servo bridge on the board that lies in a folder."""
    words = ("-r", f"__ns:={namespace}", "-p", f"port:={folder / 'board'}", "-p", "open_wait_s:=0.0")
    return NodeProcess(
        "servo_bridge.nodes.bridge_node", ("--ros-args", *words, *arguments), folder / "bridge.txt"
    )


def quits_cleanly(session: TerminalSession) -> None:
    assert session.wait() == 0, session.text
    assert session.modes == session.modes_before
    assert "Traceback" not in session.text
    after = session.output.rsplit("\x1b[?1049l", 1)[-1]
    assert re.sub(r"\x1b\[[0-?]*[a-z]", "", after).strip() == ""


STEPS = [  # every key in the forms a terminal may send, and the joint it moves
    (b"\x1b[A", 0, 0.1),
    (b"\x1b[1;5B", 0, -0.1),
    (b"\x1bOd", 1, 0.1),
    (b"\x1b[C", 1, -0.1),
    (b"\x1b[27;5;43~", 2, 0.1),
    (b"\x1f", 2, -0.1),
    (b"=", 2, 0.1),
]


@pytest.mark.slow
def test_typed_keys_become_commands(robot: Robot, teleop: TerminalSession) -> None:
    expected = list(START)
    for count, (keys, joint, step) in enumerate(STEPS, 1):
        teleop.type(keys)
        expected[joint] += step
        assert robot.wait_for_commands(count)[-1] == pytest.approx(expected)
        teleop.wait_for(f"{expected[0]:.4f}")  # measured again: the next step starts there
        teleop.wait_for(f"> {JOINTS[joint]} to {expected[joint]:.4f} rad")
    teleop.type(b"q")
    assert robot.wait_for_commands(len(STEPS) + 1)[-1] == pytest.approx([-3.14 / 3] * 3)
    teleop.type(b"\x1a")  # Ctrl+Z
    assert robot.wait_for_commands(len(STEPS) + 2)[-1] == pytest.approx([-3.14 / 4] * 3)
    assert len(robot.received) == len(STEPS) + 2


@pytest.mark.slow
def test_unknown_sequences_move_nothing(robot: Robot, teleop: TerminalSession) -> None:
    teleop.type(b"\x1ba\x1b[200~qqz\x1b[A\x1b[201~\x1b[1;3A\x1b]0;qz\x07\x1b[<0;1;1M\xc3\xa9\x1b[24~")
    presses = next(count for count in range(1, 60) if robot.obeys(teleop, b"q"))
    teleop.wait_for("> pose mid")
    assert robot.received == [pytest.approx((-3.14 / 3,) * 3)] * len(robot.received)
    assert len(robot.received) <= presses


@pytest.mark.slow
def test_what_is_not_running_is_said_and_a_hang_up_ends_it_cleanly() -> None:
    with TerminalSession([*TELEOP, "--ros-args", "-r", "__ns:=/nobody"]) as session:
        session.wait_for("simulator: no data yet")
        session.wait_for("servo bridge: not running")
        for key, message in (
            (b"q", "> nothing moved: no joint_states received yet"),
            (b"a", "> simulator is not running (no service /nobody/simulator/start)"),
            (b"i", "> inverse control is not running"),
            (b"b", "> no servo bridge on /nobody/servo_bridge"),
            (b"k", "> k is not bound"),
        ):
            session.type(key)
            session.wait_for(message)
        session.type(b"?")
        session.wait_for("? shows the keys")
        session.resize(40, 6)
        assert session.wait_until(lambda: all(len(line) <= 40 for line in session.screen.split("\r\n")))
        assert "servo_2" in session.screen
        session.signal(signal.SIGHUP)
        quits_cleanly(session)


@pytest.mark.slow
def test_data_that_stops_is_seen(teleop: TerminalSession, robot: Robot) -> None:
    robot.joints = []  # messages that say nothing, as good as none
    teleop.wait_for("joint_states of another robot")
    teleop.wait_for("simulator: no data for")
    teleop.type(b"q")
    teleop.wait_for("> nothing moved: no joint_states for")
    assert robot.received == []


@pytest.mark.slow
def test_another_namespace_by_remapping_and_a_closed_window_ends_it() -> None:
    with (
        running_robot("left_hand") as robot,
        TerminalSession([*TELEOP, "--ros-args", "-r", "__ns:=/left_hand"]) as session,
    ):
        session.wait_for("topics in /left_hand")
        session.wait_for("simulator: running")
        assert robot.is_found_by(session, b"q"), session.screen
        assert robot.received[0] == pytest.approx((-3.14 / 3,) * 3)
        session.hang_up()
        assert session.wait() == 0


@pytest.mark.slow
def test_a_command_that_nobody_receives_is_refused_with_a_message() -> None:
    with (
        running_robot("deaf_hand", receives=False) as robot,
        TerminalSession([*TELEOP, "--ros-args", "-r", "__ns:=/deaf_hand"]) as session,
    ):
        session.wait_for("simulator: running")
        session.type(b"q")
        session.wait_for("> nothing moved: no node receives position_controller/commands yet")
        robot.receive()
        assert robot.is_found_by(session, b"q"), session.screen
        session.wait_for("> pose mid")
        session.type(b"\x03")
        quits_cleanly(session)


@pytest.mark.slow
def test_another_robot_by_its_file_and_a_signal_ends_it_cleanly(tmp_path: Path) -> None:
    file = tmp_path / "pusher.yaml"
    file.write_text(
        "name: pusher\n"
        "joints: [{name: rail, kind: prismatic, limits: {lower: 0.0, upper: 0.02, speed: 0.1}}]\n"
        "poses: {out: [0.015]}\n"
        "keys:\n  up: {joints: [rail], by: 0.002, help: push}\n  o: {pose: out, help: out}\n"
    )
    with running_robot("pusher", ["rail"]) as robot:
        robot.positions = [0.001]
        with TerminalSession([*TELEOP, "--ros-args", "-p", f"robot:={file}"]) as session:
            session.wait_for("topics in /pusher")
            session.wait_for("simulator: running")
            assert robot.is_found_by(session, b"o"), session.screen
            session.wait_for("> pose out")
            session.type(b"\x1b[A")
            session.wait_for("> rail to 0.0170 m (17.0 mm)")
            assert session.wait_until(lambda: robot.received[-1] == pytest.approx((0.017,)))
            session.signal(signal.SIGTERM)
            quits_cleanly(session)


@pytest.mark.slow
def test_the_servo_bridge_is_started_and_stopped(
    tmp_path: Path, robot: Robot, teleop: TerminalSession
) -> None:
    with VirtualBoard(link=tmp_path / "board") as board:
        bridge = started_bridge(tmp_path, "/tripod")
        try:
            teleop.wait_for("servo bridge: init")
            teleop.type(b"b")
            teleop.wait_for("servo bridge: comm")
            teleop.wait_for("> sending to the servo board")
            teleop.type(b"q")
            robot.wait_for_commands(1)
            assert board.wait_for(lambda b: b.servo_bytes == (119, 119, 119))
            released = time.monotonic() + HOLD_GAP_S  # sooner than this again, the key would count as held
            assert teleop.wait_until(lambda: time.monotonic() > released)
            teleop.type(b"\x02")
            teleop.wait_for("servo bridge: no-comm")
            teleop.wait_for("> stopped sending")
            bridge.process.kill()
            teleop.wait_for("servo bridge: not running")
        finally:
            bridge.process.kill()
            bridge.process.wait()


@pytest.mark.slow
def test_a_bare_robot_is_driven_from_what_its_bridge_applied_and_an_interrupt_ends_it_cleanly(
    tmp_path: Path,
) -> None:
    """In a ROS domain of its own: in that of the module a bridge was killed, and left its mailbox behind."""
    with private_ros(tmp_path), VirtualBoard(link=tmp_path / "board") as board:
        bridge = started_bridge(tmp_path, "/bare", "-p", "source:=commands")
        try:
            assert bridge.says("reached by nodes", BUILD_S), bridge.state
            with TerminalSession([*TELEOP, "--ros-args", "-r", "__ns:=/bare"]) as session:
                session.wait_for("servo bridge: init")
                session.type(b"b")
                session.wait_for("servo bridge: comm")
                session.wait_for("-0.5061")  # byte 150, measured by nobody, applied by the bridge
                session.type(b"q")
                assert board.wait_for(lambda b: b.servo_bytes == (119, 119, 119))
                sent = len(board.packets)  # longer than the bridge's patience: 2.5 s at 50 Hz
                assert board.wait_for(lambda b: len(b.packets) >= sent + 125)
                # a bridge that was paused meanwhile begins to go to rest, until it hears the next command
                assert board.wait_for(lambda b: b.servo_bytes == (119, 119, 119))
                session.type(b"\x1b[A")
                assert board.wait_for(lambda b: b.servo_bytes[0] == 124)
                session.signal(signal.SIGINT)
                quits_cleanly(session)
        finally:
            bridge.end()


REFUSALS: list[tuple[list[str], str]] = [
    ([], "softsim run teleop"),
    (["--ros-args", "-p", "robot:=no_such_robot"], "no_such_robot"),
    (["--ros-args", "-p", "robot:=3"], "robot"),
    (["--ros-args", "-p", "repeat_interval:=99.0"], "repeat_interval"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("arguments", "wanted"), REFUSALS)
def test_refusals_are_one_sentence(
    ros_domain: int,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    wanted: str,
) -> None:
    with Path(os.devnull).open() as nothing:
        monkeypatch.setattr(sys, "stdin", nothing)
        assert main(arguments) == 1
    written = capfd.readouterr().err
    said = [line for line in written.splitlines() if "reached by" not in line]
    assert len(said) == 1, written
    assert wanted in said[0]
