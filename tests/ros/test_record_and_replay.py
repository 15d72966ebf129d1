"""Recorder and replay as processes: what goes over the topics, into the file and out again."""

from __future__ import annotations

import random
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rosbags")

from diagnostic_msgs.msg import DiagnosticArray
from node_processes import Client, ProcessGroup, private_ros
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray
from std_srvs.srv import SetBool

from softsim_node import STATE_QOS
from softsim_ros import StateListener
from softsim_ros.cli import run_command as main
from softsim_ros.recording import Bag, Recorder

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.shared_robot("tripod")]

CLI = "softsim_ros.cli"
READY_S = 120.0
COMMANDS = "position_controller/commands"


def counts(folder: Path) -> dict[str, int]:
    with Bag(folder) as bag:
        return bag.counts


@pytest.fixture(scope="module")
def session(
    running_tripod: Any, start_process: Callable[..., Any], spin_until: Any, tmp_path_factory: Any
) -> tuple[Path, list[bytes]]:
    """A recording of a start animation and thirty commands, and the commands as another node heard them."""
    folder = tmp_path_factory.mktemp("bags") / "session"
    client = running_tripod.client
    heard = client.collect(Float64MultiArray, COMMANDS, raw=True)
    points = client.node.create_publisher(Float64MultiArray, COMMANDS, 100)
    recorder = start_process(CLI, "record", "tripod", "--out", str(folder))
    assert recorder.says("recording to", READY_S), recorder.output
    # the simulator and the recorder listen, and so does this test
    assert spin_until(lambda: points.get_subscription_count() == 3, READY_S)
    mesh = client.node.count_subscribers
    assert spin_until(lambda: mesh("/tripod/mesh/points") == 1 and mesh("/tripod/joint_states") == 1, READY_S)
    assert running_tripod.trigger("start")[0]
    reports = client.collect(DiagnosticArray, "/diagnostics")
    assert spin_until(lambda: len(reports) > 1, READY_S)
    numbers = random.Random(5)
    for count in range(1, 31):
        points.publish(Float64MultiArray(data=[numbers.uniform(-1.5, -0.8) for _ in range(3)]))
        assert spin_until(lambda count=count: len(heard) == count, READY_S)
    assert points.wait_for_all_acked(Duration(seconds=READY_S))
    assert recorder.end() == 0, recorder.output
    assert " messages on " in recorder.output
    client.node.destroy_publisher(points)
    return folder, [bytes(each) for each in heard]


def test_everything_of_the_robot_is_in_the_bag(session: tuple[Path, list[bytes]]) -> None:
    seen = counts(session[0])
    assert seen[f"/tripod/{COMMANDS}"] == 30
    assert seen["/tripod/mesh/topology"] == 1
    assert seen["/tripod/base_shift"] > 1
    assert min(seen["/tripod/joint_states"], seen["/tripod/effector_pose"]) > 30
    assert seen["/tripod/mesh/points"] > 3
    assert seen["/diagnostics"] > 0
    assert seen["/tripod/simulator/paused"] == 1
    assert "/tripod/mesh/marker" not in seen


def test_the_independent_reader_counts_and_stamps_the_same(session: tuple[Path, list[bytes]]) -> None:
    reader, decoder = pytest.importorskip("mcap.reader"), pytest.importorskip("mcap_ros2.decoder")
    with Bag(session[0]) as bag:
        ours = [tuple(message) for message in bag.raw_messages()]
    with (session[0] / "session.mcap").open("rb") as stream:
        theirs = [
            (channel.topic, message.log_time, message.data)
            for _, channel, message in reader.make_reader(stream).iter_messages()
        ]
    assert sorted(theirs) == sorted(ours)
    assert [stamp for _, stamp, _ in theirs] == sorted(stamp for _, stamp, _ in ours)
    with (session[0] / "session.mcap").open("rb") as stream:
        decoded = reader.make_reader(stream, decoder_factories=[decoder.DecoderFactory()])
        rows = [message for *_, message in decoded.iter_decoded_messages(topics="/tripod/joint_states")]
    assert {tuple(row.name) for row in rows} == {("servo_0", "servo_1", "servo_2")}


def test_the_commands_are_replayed_byte_for_byte(
    session: tuple[Path, list[bytes]], client: Any, spin_until: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    folder, sent = session
    heard = client.collect(Float64MultiArray, f"/elsewhere/{COMMANDS}", raw=True)
    assert main(["replay", str(folder), "--commands", "--namespace", "elsewhere"]) == 0
    assert "30 messages sent" in "".join(capfd.readouterr())
    assert spin_until(lambda: len(heard) == 30, READY_S)
    assert [bytes(each) for each in heard] == sent


def test_the_robot_does_again_what_it_did(
    session: tuple[Path, list[bytes]], running_tripod: Any, spin_until: Any
) -> None:
    """Reset, start animation, commands: the joints end where the recorded ones were told to go."""
    with Bag(session[0]) as bag:
        *_, (_, last) = bag.messages(f"/tripod/{COMMANDS}")
    states = running_tripod.client.collect(JointState, "joint_states")
    assert main(["replay", str(session[0]), "--commands", "--reset"]) == 0
    assert spin_until(
        lambda: states and list(states[-1].position) == pytest.approx(list(last.data), abs=1e-3), READY_S
    )
    shifts = running_tripod.client.collect(*latched_shift())
    assert spin_until(lambda: shifts and shifts[-1].data == pytest.approx(0.035), READY_S)


def latched_shift() -> tuple[Any, str, Any]:
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from std_msgs.msg import Float64

    return Float64, "base_shift", QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def test_a_whole_replay_gives_way_to_a_simulator(
    session: tuple[Path, list[bytes]], running_tripod: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(session[0]), "--loop"]) == 1  # it has heard the simulator
    assert "is published by another node; end that one" in "".join(capfd.readouterr())


def test_a_whole_replay_pauses_loops_and_ends_on_a_signal(
    session: tuple[Path, list[bytes]], start_process: Callable[..., Any], client: Any, spin_until: Any
) -> None:
    states = client.collect(JointState, "/copy/joint_states")
    replay = start_process(CLI, "replay", str(session[0]), "--namespace", "copy", "--loop")
    recorded = counts(session[0])["/tripod/joint_states"]
    assert spin_until(lambda: len(states) > 3, READY_S), replay.output
    assert client.call(SetBool, "/copy/replay/pause", SetBool.Request(data=True)).message == "paused"
    paused = client.collect(Bool, "/copy/replay/paused", STATE_QOS)
    assert spin_until(lambda: [each.data for each in paused] == [True])
    assert client.call(SetBool, "/copy/replay/pause", SetBool.Request(data=False)).message == "playing"
    assert spin_until(lambda: [each.data for each in paused] == [True, False])
    assert client.node.count_publishers("/copy/simulator/paused") == 0
    assert spin_until(lambda: len(states) > recorded + 3, READY_S), replay.output  # the second round
    assert replay.end() == 0
    assert "Traceback" not in replay.output


def test_the_recorder_node_begins_and_ends_when_told(
    running_tripod: Any, start_process: Callable[..., Any], client: Any, spin_until: Any, tmp_path: Path
) -> None:
    node = "softsim_ros.recording.recorder_node"
    folder = tmp_path / "told"
    process = start_process(node, "--ros-args", "-p", "autostart:=false", "-p", f"out:={folder}")

    def enable(on: bool) -> tuple[bool, str]:
        answer = client.call(SetBool, "recorder/enable", SetBool.Request(data=on))
        return answer.success, answer.message

    assert enable(False) == (False, "nothing is being recorded")
    enabled = StateListener(client.node, "recorder/enabled")
    assert enable(True) == (True, f"recording to {folder}")
    assert spin_until(lambda: enabled.value is True)
    assert not enable(True)[0]
    ended, sentence = enable(False)
    assert ended
    assert " messages on " in sentence
    again, sentence = enable(True)
    assert not again
    assert "exists already and is kept" in sentence
    assert process.end() == 0


def test_what_has_come_before_the_end_is_recorded(client: Any, spin_until: Any, tmp_path: Path) -> None:
    values = {"out": str(tmp_path / "bag"), "topics": "/points"}
    points = client.node.create_publisher(Float64MultiArray, "/points", 100)
    assert spin_until(lambda: client.node.count_publishers("/points") == 1)
    parameters = [Parameter(name, value=value) for name, value in values.items()]
    recorder = Recorder(context=client.context, parameter_overrides=parameters)  # nobody serves it
    try:
        assert spin_until(lambda: points.get_subscription_count() == 1)
        for value in range(30):
            points.publish(Float64MultiArray(data=[float(value)]))
        assert points.wait_for_all_acked(Duration(seconds=READY_S))
        recorder.end()
    finally:
        recorder.close()
        client.node.destroy_publisher(points)
    assert counts(tmp_path / "bag") == {"/points": 30}


@pytest.mark.parametrize(
    "words", [("tripod", "--size-limit", "0.05"), ("--topic", "joint_states", "--time-limit", "1")]
)
def test_a_limit_ends_the_recording_of_what_was_named(
    running_tripod: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str], words: tuple[str, ...]
) -> None:
    assert main(["record", "--out", str(tmp_path / "bag"), *words]) == 0
    assert "is reached" in "".join(capfd.readouterr())
    seen = counts(tmp_path / "bag")
    assert seen["/tripod/joint_states"] > 0
    assert list(seen) == ["/tripod/joint_states"] or "--topic" not in words


@pytest.fixture
def apart(tmp_path: Path) -> Iterator[int]:
    """A ROS domain of its own: what a killed process leaves behind disturbs no other test."""
    with private_ros(tmp_path) as domain:
        yield domain


def test_a_killed_recorder_loses_at_most_its_last_second(
    apart: int, spin_until: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    folder, start = tmp_path / "killed", ProcessGroup(tmp_path)
    client = Client(apart, "tripod", start)
    points = client.node.create_publisher(Float64MultiArray, "points", 100)
    client.node.create_timer(0.01, lambda: points.publish(Float64MultiArray(data=[1.0] * 100)))
    recorder = start(CLI, "record", "--out", str(folder), "--topic", "points")
    file = folder / "killed.mcap"
    assert spin_until(lambda: file.exists() and file.stat().st_size > 1000, READY_S), recorder.output
    size = file.stat().st_size
    assert spin_until(lambda: file.stat().st_size > size, READY_S)  # another second
    recorder.end(signal.SIGKILL)
    client.close()
    assert main(["export", str(folder)]) == 1
    assert "was not closed" in "".join(capfd.readouterr())
    assert main(["record", "--repair", str(folder)]) == 0
    assert "repaired, " in "".join(capfd.readouterr())
    assert counts(folder)["/tripod/points"] > 10
