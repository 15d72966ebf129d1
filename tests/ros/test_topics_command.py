"""`softsim topics` against real publishers in another process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from waiting import DEADLINE_S

pytest.importorskip("rclpy")

REPOSITORY = Path(__file__).resolve().parents[2]

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.usefixtures("ros_domain")]

PUBLISHER = """
import array, rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
rclpy.init()
node = rclpy.create_node("source", namespace="robot")
keep = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
latched = node.create_publisher(String, "name", keep)
latched.publish(String(data="tripod"))
states = node.create_publisher(JointState, "joint_states", 10)
hidden = node.create_publisher(String, "reach/_action/feedback", 10)
long = node.create_publisher(Float64MultiArray, "long", 10)
message = JointState(name=["servo_0"], position=array.array("d", [-1.25]))
def tick():
    states.publish(message)
    long.publish(Float64MultiArray(data=array.array("d", range(40))))
node.create_timer(0.02, tick)
print("ready", flush=True)
try:
    while rclpy.ok():
        rclpy.spin_once(node, timeout_sec=0.1)
except BaseException:
    pass
"""


def topics(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "softsim_ros.cli", "topics", *words],
        cwd=REPOSITORY,
        env={**os.environ, "PYTHONPATH": str(REPOSITORY)},
        capture_output=True,
        text=True,
        timeout=180,
        check=False,
    )


@pytest.fixture
def source(ros_domain: int) -> Iterator[None]:
    with subprocess.Popen([sys.executable, "-c", PUBLISHER], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        yield
        process.send_signal(signal.SIGINT)
        process.wait(DEADLINE_S)


@pytest.mark.usefixtures("source")
def test_live_topics_are_listed_with_their_ends() -> None:
    done = topics()
    assert done.returncode == 0, done.stderr
    rows = [line.split() for line in done.stdout.splitlines()]
    assert rows[0] == ["topic", "type", "publishers", "subscribers"]
    assert ["/robot/joint_states", "sensor_msgs/msg/JointState", "1", "0"] in rows
    names = {row[0] for row in rows}
    assert not names & {"/rosout", "/robot/reach/_action/feedback"}
    everything = {line.split()[0] for line in topics("--all").stdout.splitlines()}
    assert everything > names | {"/rosout", "/robot/reach/_action/feedback"}


@pytest.mark.usefixtures("source")
def test_messages_are_printed_and_long_arrays_shortened() -> None:
    done = topics("--echo", "robot/joint_states", "--count", "2")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("position: [-1.25]") == 2
    assert "name: [servo_0]" in done.stdout
    done = topics("--echo", "/robot/long", "--count", "1")
    assert "... 40 in all" in done.stdout
    done = topics("--echo", "/robot/long", "--count", "1", "--full")
    assert "38, 39]" in done.stdout


@pytest.mark.usefixtures("source")
def test_latched_messages_are_heard() -> None:
    assert "data: tripod" in topics("--echo", "/robot/name", "--count", "1").stdout


@pytest.mark.usefixtures("source")
def test_a_rate_is_measured() -> None:
    done = topics("--hz", "/robot/joint_states", "--count", "2")
    assert done.returncode == 0, done.stderr
    rate = float(done.stdout.splitlines()[-1].split(" Hz")[0])
    assert 25.0 < rate < 55.0  # 50 Hz asked; the machine may be busy


def test_silence_says_where_it_listened(ros_domain: int) -> None:
    done = topics()
    assert done.returncode == 0
    assert f"domain {ros_domain}, discovery range LOCALHOST" in done.stdout
    done = topics("--echo", "/nothing", "--wait", "0.5")
    assert done.returncode == 1
    assert "nobody publishes /nothing" in done.stderr
    assert "Traceback" not in done.stderr
