"""`softsim topics` against real publishers in another process."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable, Iterator

import pytest
from waiting import DEADLINE_S, spin_until

pytest.importorskip("rclpy")

from softsim_ros.cli import run_command as main
from softsim_ros.cli.graph import Rate, graph

pytestmark = [pytest.mark.ros]

Topics = Callable[..., "tuple[int, str, str]"]

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


@pytest.fixture
def topics(ros_domain: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Topics:
    """Run the command; return its exit code and what it wrote to its two outputs.

    A list is taken for settled sooner than by users; who misses something asks again.
    """
    for name in ("FIRST_WITHIN_S", "OTHERS_S"):
        monkeypatch.setattr(graph, name, 0.5)

    def run(*words: str) -> tuple[int, str, str]:
        return main(["topics", "--wait", "60", *words]), *capsys.readouterr()

    return run


@pytest.fixture(scope="module")
def source(ros_domain: int) -> Iterator[None]:
    with subprocess.Popen([sys.executable, "-c", PUBLISHER], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        yield
        process.send_signal(signal.SIGINT)
        process.wait(DEADLINE_S)


@pytest.mark.slow
def test_silence_says_where_it_listened(topics: Topics, ros_domain: int) -> None:
    code, shown, _ = topics()  # no source runs yet
    assert code == 0
    assert f"domain {ros_domain}, discovery range LOCALHOST" in shown
    code, _, refused = topics("--echo", "/nothing", "--wait", "0.5")
    assert code == 1
    assert "no node publishes /nothing" in refused
    assert "Traceback" not in refused


@pytest.mark.slow
@pytest.mark.usefixtures("source")
def test_live_topics_are_listed_with_their_ends(topics: Topics) -> None:
    source = ["/robot/joint_states", "sensor_msgs/msg/JointState", "1", "0"]
    hidden = {"/rosout", "/robot/reach/_action/feedback"}

    def listed(*words: str) -> list[list[str]]:
        code, shown, written = topics(*words)
        assert code == 0, written
        return [line.split() for line in shown.splitlines()]

    tables: list[list[list[str]]] = []

    def shows_source() -> bool:
        tables.append(listed())
        return source in tables[-1]

    assert spin_until(shows_source), tables
    rows = tables[-1]
    assert rows[0] == ["topic", "type", "publishers", "subscribers"]
    names = {row[0] for row in rows}
    assert not names & hidden
    assert spin_until(lambda: {row[0] for row in listed("--all")} > names | hidden)


@pytest.mark.slow
@pytest.mark.usefixtures("source")
def test_messages_are_printed_and_long_arrays_shortened(topics: Topics) -> None:
    code, shown, written = topics("--echo", "robot/joint_states", "--count", "2")
    assert code == 0, written
    assert shown.count("position: [-1.25]") == 2
    assert "name: [servo_0]" in shown
    assert "... 40 in all" in topics("--echo", "/robot/long", "--count", "1")[1]
    assert "38, 39]" in topics("--echo", "/robot/long", "--count", "1", "--full")[1]
    assert "data: tripod" in topics("--echo", "/robot/name", "--count", "1")[1]  # a latched one


@pytest.mark.slow
@pytest.mark.usefixtures("source")
def test_a_rate_is_printed(topics: Topics) -> None:
    code, shown, written = topics("--hz", "/robot/joint_states", "--count", "2")
    assert code == 0, written
    assert len(shown.splitlines()) == 2


def test_a_rate_is_that_of_the_messages_since_the_last_line(capsys: pytest.CaptureFixture[str]) -> None:
    times = iter((0.0, *(0.0, 0.0), *(0.02, 0.02), *(0.06, 0.06), *(0.08, 0.08), 1.0, 2.0, 2.08, 3.0))
    rate = Rate(clock=lambda: next(times))
    for _ in range(4):
        rate(b"12345")
        rate.report()
    rate.report()
    rate.report()
    rate(b"12345")
    rate.report()
    assert rate.lines == 3
    assert capsys.readouterr().out.splitlines() == [
        "37.5 Hz  gaps 20.0 to 40.0 ms  5 bytes a message",
        "no message in the last second",
        "0.5 Hz  gaps 2000.0 to 2000.0 ms  5 bytes a message",
    ]
