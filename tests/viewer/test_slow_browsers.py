"""Browsers that stall, close or never read: the robot runs on, and no memory is taken for them."""

from __future__ import annotations

import socket
from collections.abc import Callable
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

import viser
from diagnostic_msgs.msg import DiagnosticArray
from diagnostics import diagnostic_values
from node_processes import resident_mb
from tcp_ports import free_port
from waiting import DEADLINE_S

pytestmark = [pytest.mark.ros, pytest.mark.slow]

VIEWER = "softsim_ros.nodes.viewer.viewer_node"


def connected(port: int) -> socket.socket:
    """A page that finished its handshake; what it does then is up to the test."""
    link = socket.create_connection(("127.0.0.1", port), timeout=DEADLINE_S)
    link.sendall(
        (
            f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
            f"Sec-WebSocket-Protocol: viser-v{viser.__version__}\r\n\r\n"
        ).encode()
    )
    assert link.recv(12) == b"HTTP/1.1 101"
    return link


class Reports:
    """What the simulator says of itself, once a second."""

    def __init__(self, robot: Any, spin_until: Callable[..., bool]) -> None:
        self._heard = robot.client.collect(DiagnosticArray, "/diagnostics", 10)
        self._spin_until = spin_until

    def during(self, steps: int) -> list[dict[str, str]]:
        """Reports of at least so many steps from now; the next that comes still tells of the time before."""
        begin = len(self._simulator()) + 1

        def done() -> bool:
            new = self._simulator()[begin:]
            return len(new) > 1 and int(new[-1]["steps"]) - int(new[0]["steps"]) >= steps

        assert self._spin_until(done)
        return self._simulator()[begin:]

    def _simulator(self) -> list[dict[str, str]]:
        found = (diagnostic_values(message, "tripod/simulator") for message in list(self._heard))
        return [values for values in found if float(values.get("cpu_ms_per_step", 0.0)) > 0.0]


def test_browsers_that_never_read_or_vanish_leave_the_robot_alone(
    start_robot: Callable[..., Any], start_process: Callable[..., Any], spin_until: Callable[..., bool]
) -> None:
    robot = start_robot()
    reports = Reports(robot, spin_until)
    port = free_port()
    viewer = start_process(VIEWER, "--ros-args", "-p", f"port:={port}", "-p", "no_token:=true")
    assert viewer.says("viewer: http"), viewer.output
    silent = [connected(port) for _ in range(3)]
    for _ in range(5):
        connected(port).close()
    connected(port).shutdown(socket.SHUT_RD)
    reports.during(200)
    pids = (viewer.process.pid, robot.process.process.pid)
    before = [resident_mb(pid) for pid in pids]
    watched = reports.during(700)
    assert all(report["state"] == "running" for report in watched)
    assert all(resident_mb(pid) < was + 25.0 for pid, was in zip(pids, before, strict=True))
    assert viewer.process.poll() is None
    fresh = connected(port)  # a new page is served
    fresh.settimeout(DEADLINE_S)
    assert len(fresh.recv(65536)) > 0
    for link in (*silent, fresh):
        link.close()
