"""The profile that binds the middleware to loopback: no port is open elsewhere, everybody here is met."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from node_processes import Client
from waiting import spin_until

pytest.importorskip("rclpy")
from std_msgs.msg import String

pytestmark = [pytest.mark.ros, pytest.mark.slow]

PROFILE = Path(__file__).resolve().parents[2] / "configs" / "dds" / "loopback.xml"
ECHO = """
import sys
import rclpy
from rclpy.node import Node
from std_msgs.msg import String
rclpy.init()
node = Node("echo_" + sys.argv[1])
publisher = node.create_publisher(String, "answers", 10)
def answer(question):
    publisher.publish(String(data=sys.argv[1] + question.data))
node.create_subscription(String, "questions", answer, 10)
print("ready", flush=True)
while rclpy.ok():
    rclpy.spin_once(node, timeout_sec=0.1)
"""


@contextmanager
def echo(name: str) -> Iterator[int]:
    """Run a node that answers what is asked, in a process of its own; its number."""
    process = subprocess.Popen([sys.executable, "-c", ECHO, name], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        yield process.pid
    finally:
        process.kill()
        process.wait()


def bound(pid: int) -> list[tuple[str, int]]:
    """Addresses and ports of the UDP sockets of a process."""
    sockets = set()
    for link in Path(f"/proc/{pid}/fd").iterdir():
        with suppress(OSError):
            sockets.add(str(link.readlink()))
    found = []
    for row in Path(f"/proc/{pid}/net/udp").read_text().splitlines()[1:]:
        words = row.split()
        if f"socket:[{words[9]}]" in sockets:
            address, _, port = words[1].partition(":")
            found.append((".".join(str(byte) for byte in reversed(bytes.fromhex(address))), int(port, 16)))
    return found


def open_addresses(pid: int, domain: int) -> set[str]:
    """Where a process listens on the ports of a ROS domain."""
    ports = range(7400 + 250 * domain, 7650 + 250 * domain)
    return {address for address, port in bound(pid) if port in ports}


def test_with_the_profile_no_port_of_the_domain_is_open_elsewhere(
    client: Client, ros_domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = client.collect(String, "/answers", 10)
    with echo("open") as other:
        monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", str(PROFILE))
        with echo("closed") as closed, echo("more") as more:
            assert open_addresses(other, ros_domain) == {"0.0.0.0"}  # what the profile is for
            assert open_addresses(closed, ros_domain) == {"127.0.0.1"}
            assert open_addresses(more, ros_domain) == {"127.0.0.1"}

            def all_have_answered() -> bool:
                client.publish("/questions", String(data="?"))
                return {each.data for each in answers} == {"open?", "closed?", "more?"}

            assert spin_until(all_have_answered), answers
