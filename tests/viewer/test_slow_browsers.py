"""A browser that stalls, closes or never reads costs the robot nothing: steps go on, memory stays."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

import viser
from sensor_msgs.msg import JointState
from tcp_ports import free_port

pytestmark = [pytest.mark.ros, pytest.mark.slow]

VIEWER = "softsim_ros.viewer.viewer_node"
MEGABYTE = 1e6


def resident_mb(pid: int) -> float:
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return float(line.split()[1]) * 1024 / MEGABYTE
    raise AssertionError("no memory told")


def connected(port: int) -> socket.socket:
    """A page that finished its handshake; what it does then is up to the test."""
    link = socket.create_connection(("127.0.0.1", port), timeout=30)
    link.sendall(
        (
            f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
            f"Sec-WebSocket-Protocol: viser-v{viser.__version__}\r\n\r\n"
        ).encode()
    )
    assert link.recv(12) == b"HTTP/1.1 101"
    return link


def test_browsers_that_never_read_or_vanish_leave_the_robot_alone(
    start_robot: Callable[..., Any], start_process: Callable[..., Any], spin_until: Callable[..., bool]
) -> None:
    robot = start_robot()
    port = free_port()
    viewer = start_process(VIEWER, "--ros-args", "-p", f"port:={port}")
    assert viewer.says("viewer: http", 60.0), viewer.output
    states = robot.client.collect(JointState, "joint_states", 10)
    assert spin_until(lambda: states)
    silent = [connected(port) for _ in range(3)]
    for _ in range(5):
        connected(port).close()
    connected(port).shutdown(socket.SHUT_RD)
    assert spin_until(lambda: len(states) > 300, 60.0)
    before, count, began = resident_mb(viewer.process.pid), len(states), time.monotonic()
    assert spin_until(lambda: len(states) > count + 700, 60.0)
    assert time.monotonic() - began < 30.0  # 7 s of steps on a machine that is not busy with others
    assert resident_mb(viewer.process.pid) < before + 25.0
    assert viewer.process.poll() is None
    fresh = connected(port)  # a new page is served
    fresh.settimeout(30.0)
    assert len(fresh.recv(65536)) > 0
    for link in (*silent, fresh):
        link.close()


def test_the_viewer_ends_with_the_program_that_started_it(start_process: Callable[..., Any]) -> None:
    viewer = start_process(VIEWER, "--ros-args", "-p", f"port:={free_port()}", "-p", "parent:=1")
    assert viewer.process.wait(60) == 0  # its parent is this test
