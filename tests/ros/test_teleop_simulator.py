"""The teleop and the real simulator, each in its own process: typed keys move the simulated servos."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any

import pytest
from terminal_session import TerminalSession

pytest.importorskip("rclpy")

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.shared_robot("tripod")]

START, MID, HIGH = "-1.4965", "-1.0467", "-0.7850"


@pytest.fixture(scope="module")
def terminal(running_tripod: Any) -> Iterator[TerminalSession]:
    """One teleop for all tests."""
    with TerminalSession([sys.executable, "-m", "softsim_ros.nodes.teleop.teleop_node"]) as session:
        session.wait_for("simulator: running at")
        yield session
        session.type(b"x")
        assert session.wait() == 0
        assert session.modes == session.modes_before
        assert "Traceback" not in session.text


@pytest.fixture
def teleop(tripod: Any, terminal: TerminalSession) -> TerminalSession:
    """The teleop, which shows the robot at its start."""
    assert shows(terminal, "0.0000", "0.0000", "0.0000"), terminal.screen
    return terminal


def measured(session: TerminalSession) -> list[str]:
    """Measured joint positions on the screen."""
    rows = [line.split() for line in session.screen.split("\r\n") if line.startswith("servo_")]
    return [row[-2] for row in rows]


def shows(session: TerminalSession, *positions: str) -> bool:
    return session.wait_until(lambda: measured(session) == list(positions))


def test_keys_move_the_simulated_servos(teleop: TerminalSession) -> None:
    teleop.type(b"a")
    assert shows(teleop, START, START, START), teleop.screen
    teleop.type(b"\x1b[1;5A")
    assert shows(teleop, "-1.3965", START, START), teleop.screen
    teleop.type(b"\x1b[D")
    assert shows(teleop, "-1.3965", "-1.3965", START), teleop.screen
    teleop.type(b"-")
    assert shows(teleop, "-1.3965", "-1.3965", "-1.5965"), teleop.screen
    teleop.type(b"q")
    assert shows(teleop, MID, MID, MID), teleop.screen
    teleop.type(b"\x1a")
    assert shows(teleop, HIGH, HIGH, HIGH), teleop.screen


def test_pause_and_reset(teleop: TerminalSession, tripod: Any) -> None:
    teleop.type(b"q")
    assert shows(teleop, MID, MID, MID), teleop.screen
    teleop.type(b" ")
    teleop.wait_for("simulator: paused")
    teleop.wait_for("> simulator: paused")
    assert tripod.pause(False)[0]  # somebody else lets it go on
    teleop.wait_for("simulator: running at")
    teleop.type(b"r")
    assert shows(teleop, "0.0000", "0.0000", "0.0000"), teleop.screen
    teleop.wait_for("> simulator: back at the start")


def test_limits_follow_the_simulator(teleop: TerminalSession, tripod: Any) -> None:
    teleop.type(b"\x1b[A")
    teleop.wait_for("> servo_0 stops at its upper limit -0.0255 rad (-1.5 deg)")
    assert shows(teleop, "-0.0255", "-0.0255", "-0.0255"), teleop.screen
    assert tripod.set_parameters(enforce_limits=False)[0]
    teleop.wait_for("limits off")
    teleop.type(b"\x1b[A")
    teleop.wait_for("> servo_0 to 0.0745 rad")
    assert shows(teleop, "0.0745", "-0.0255", "-0.0255"), teleop.screen
