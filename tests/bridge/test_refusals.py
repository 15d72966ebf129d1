"""What the bridge refuses, and how: one bounded, printable sentence; and its own faults."""

from __future__ import annotations

import contextlib
import os
import random
import re
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from bridge_session import spinning

pytest.importorskip("rclpy")

from board_driving import robot
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from servo_bridge.driver import DELAYS_S, BoardSession, EStop, ServoDriver, board_session
from servo_bridge.emulator import VirtualBoard
from servo_bridge.nodes import (
    MOST_BYTES,
    BridgeSettings,
    ServoBridge,
    assemble,
    command_values,
    joint_positions,
    main,
)
from softsim_core.base import CommandError, SceneError, SoftSimError
from softsim_node import LONGEST_MESSAGE, error_text, list_names

pytestmark = pytest.mark.slow

Starter = Callable[..., Any]
ESCAPE = "\x1b]0;owned\x07\x1b[2J"


def states(*names: str) -> bytes:
    return bytes(serialize_message(JointState(name=list(names), position=[-1.0] * len(names))))


@pytest.mark.parametrize("unpack", [command_values, joint_positions])
def test_a_long_message_is_refused_before_it_is_unpacked(unpack: Callable[[bytes], object]) -> None:
    with pytest.raises(CommandError, match=f"message of {MOST_BYTES + 1} bytes refused; allowed are"):
        unpack(bytes(MOST_BYTES + 1))


@pytest.mark.parametrize("unpack", [command_values, joint_positions])
def test_damaged_bytes_are_refused(unpack: Callable[[bytes], object]) -> None:
    whole, rng = states("servo_0", "servo_1", "servo_2"), random.Random(3)
    refused = 0
    for _ in range(300):
        data = bytearray(whole[: rng.randint(4, len(whole))])
        for _ in range(rng.randint(0, 4)):
            data[rng.randrange(4, len(data)) if len(data) > 4 else 0] = rng.choice((0, 1, 127, 255))
        try:
            unpack(bytes(data))
        except CommandError:
            refused += 1
    assert refused > 30
    assert re.fullmatch(
        r"message refused: its 4 bytes are no \w+; nothing was moved", refusal(unpack, b"\0\1\0\0")
    )


def refusal(unpack: Callable[[bytes], object], data: bytes) -> str:
    with pytest.raises(CommandError) as caught:
        unpack(data)
    return str(caught.value)


def test_a_joint_named_twice_is_refused_whole() -> None:
    assert joint_positions(states("a", "b")) == {"a": -1.0, "b": -1.0}
    with pytest.raises(CommandError, match="name a, b twice refused; name every joint once; nothing was mov"):
        joint_positions(states("a", "b", "c", "b", "a"))
    with pytest.raises(CommandError, match="1 names with 0 positions refused"):
        joint_positions(bytes(serialize_message(JointState(name=["a"]))))


def test_a_refusal_is_short_and_printable_whatever_the_names_are() -> None:
    driver = ServoDriver(robot())
    names = [f"{ESCAPE}{number}{'x' * 90}\n" for number in range(500)]
    with pytest.raises(CommandError) as caught:
        driver.command_named(dict.fromkeys(names, -1.0))
    text = str(caught.value)
    assert text.isprintable()
    assert len(text) <= LONGEST_MESSAGE
    assert text.startswith("joint states without j0, j1, j2 refused; they name ")
    assert text.endswith("and 490 more; nothing was moved")
    assert driver.counts.last_refusal == text


def test_names_and_sentences_are_bounded() -> None:
    assert list_names([]) == "none"
    assert list_names(["servo_0", "servo_1"]) == "servo_0, servo_1"
    assert list_names([str(number) for number in range(10)]) == "0, 1, 2, 3, 4, 5, 6, 7, 8, 9"
    assert list_names([str(number) for number in range(12)]) == "0, 1, 2, 3, 4, 5, 6, 7, 8, 9 and 2 more"
    assert list_names(["a" * 100]) == "a" * 13 + "..."
    assert error_text("x\x1b[0m\n" * 1000).isprintable()
    assert len(error_text("\U0001f600\x00" * 10_000)) <= LONGEST_MESSAGE


def test_two_hundred_thousand_foreign_names_are_one_short_refusal(
    start_bridge: Starter, client: Any, board: VirtualBoard, wait_until: Starter
) -> None:
    bridge = start_bridge(source="joint_states", autostart="activate")
    assert board.wait_for(lambda b: b.accepted > 5)
    diagnostics = client.collect(DiagnosticArray, "/diagnostics")
    names = [f"{ESCAPE}{number}" for number in range(200_000)]
    client.publish("joint_states", JointState(name=names, position=[0.0] * len(names)))
    assert bridge.says("bytes refused; allowed are 65536; nothing was moved")
    client.publish("joint_states", JointState(name=names[:900], position=[0.0] * 900))

    def refused() -> str:
        return next(
            (
                pair.value
                for message in reversed(diagnostics)
                for status in message.status
                for pair in status.values
                if pair.key == "last refusal" and "they name" in pair.value
            ),
            "",
        )

    assert wait_until(refused)
    assert len(refused()) <= LONGEST_MESSAGE
    assert refused().isprintable()
    assert "\x1b]" not in bridge.output
    assert max(map(len, bridge.output.splitlines())) < 500
    accepted = board.accepted
    assert board.wait_for(lambda b: b.accepted > accepted + 10)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("rate:=0.001", "0.001 is refused; give 0.0, or 10 to 200 Hz"),
        ("rate:=1.0e-300", "is refused; give 0.0, or 10 to 200 Hz"),
        ("rate:=.nan", "rate"),
        ("settle_timeout:=0.0", "settle_timeout"),
        ("hold_timeout:=0.0", "hold_timeout"),
        ("rest_speed:=0.0", "rest_speed"),
    ],
)
def test_settings_that_make_no_sense_end_with_a_sentence(
    ros_domain: int, capfd: pytest.CaptureFixture[str], setting: str, words: str
) -> None:
    assert main(["--ros-args", "-r", "__ns:=/x", "-p", setting]) == 1
    output = capfd.readouterr().err
    assert words in output
    assert "Traceback" not in output


@pytest.mark.parametrize("rate", [0.1, 9.9, 201.0, float("nan"), 5e-324, float("inf")])
def test_a_rate_at_which_a_board_falls_silent_is_refused(rate: float) -> None:
    with pytest.raises(SceneError, match="packets a second refused; allowed are 10 to 200 Hz"):
        ServoDriver(robot(), rate=rate)


def settings(**changes: Any) -> BridgeSettings:
    return BridgeSettings(**({"source": "commands", "calibration": "", "settle_timeout": 1.0} | changes))


@pytest.mark.parametrize("parameter", ["robot", "calibration"])
@pytest.mark.parametrize("value", ["~nobody_of_this_name/x", "x" * 5000, "/x" * 3000, "\x00", "nested"])
def test_a_name_that_no_file_has_is_one_sentence(tmp_path: Path, parameter: str, value: str) -> None:
    if value == "nested":
        file = tmp_path / "nested.yaml"
        file.write_text("robot: " + "[" * 20_000)
        value = str(file)
    with pytest.raises(SoftSimError) as caught:
        assemble(settings(**{parameter: value}), None, EStop(), lambda reading: None)
    assert "\n" not in error_text(caught.value)
    assert len(error_text(caught.value)) <= LONGEST_MESSAGE


def test_a_robot_of_an_unknown_user_leaves_the_bridge_unconfigured(
    start_bridge: Starter, client: Any
) -> None:
    bridge = start_bridge(robot="~nobody_of_this_name/x")
    assert client.refuses("configure")
    assert bridge.says("nobody_of_this_name")
    assert "a transition failed unexpectedly" not in bridge.output
    assert client.state() == "unconfigured"


@pytest.fixture
def full_port() -> Iterator[str]:
    """A port that can be opened and takes no data."""
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(slave, False)
    with contextlib.suppress(BlockingIOError):
        while os.write(slave, bytes(4096)):
            pass
    yield os.ttyname(slave)
    os.close(slave)
    os.close(master)


@pytest.mark.slow
def test_a_port_that_takes_no_data_is_tried_ever_more_seldom(
    client: Any, full_port: str, wait_until: Starter, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried: list[float] = []  # delays until the next try of each

    def open_again(session: BoardSession, port: str, open_wait_s: float) -> None:
        tried.append(DELAYS_S[min(bridge._recovery.tries, len(DELAYS_S) - 1)])
        usual(session, port, open_wait_s)

    usual = BoardSession.open_again
    monkeypatch.setattr(BoardSession, "open_again", open_again)
    monkeypatch.setattr(board_session, "usb_identity", lambda port: "one board")  # which may be opened again
    monkeypatch.setattr(board_session, "find_same_device", lambda port, stable, usb: port)
    overrides = {"port": full_port, "autostart": "activate"}
    bridge = ServoBridge(
        scene=robot(),
        context=client.context,
        namespace="robot",
        parameter_overrides=[Parameter(name, value=value) for name, value in overrides.items()],
    )
    with spinning(bridge, client.context):
        assert wait_until(lambda: len(tried) >= 3)
    assert tried[:3] == list(DELAYS_S[1:4])


def test_a_dead_writer_is_found_and_the_servos_hold(client: Any, tmp_path: Path, wait_until: Starter) -> None:
    with VirtualBoard(link=tmp_path / "board", protocol="extended") as board:
        overrides = {"port": board.port, "autostart": "activate"}
        bridge = ServoBridge(
            scene=robot(),
            context=client.context,
            namespace="robot",
            parameter_overrides=[Parameter(name, value=value) for name, value in overrides.items()],
        )
        diagnostics = client.collect(DiagnosticArray, "/diagnostics")
        with spinning(bridge, client.context):
            assert board.wait_for(lambda b: b.accepted > 5)
            bridge._session.driver.motion.limits = None  # what no test can foresee: a fault in the program
            assert wait_until(lambda: bridge.lifecycle_state == "inactive")
            assert board.wait_for(lambda b: b.model.motion.hold_asked)

            def reported() -> bool:
                return any(
                    status.level == DiagnosticStatus.ERROR and "has ended" in status.message
                    for message in diagnostics
                    for status in message.status
                )

            assert wait_until(reported)
            accepted = board.accepted
            assert wait_until(lambda: board.model.motion._silence >= 100)  # two seconds without a word
            assert board.model.motion.holding
            assert board.accepted == accepted
