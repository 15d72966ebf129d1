"""The parts of record and replay that need no processes: clock, selection, what is sent when."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

pytest.importorskip("rosbags")

from bag_rows import COMMANDS, command, write

from softsim_ros.recording import Bag, BagError, RecordingError, ReplayClock, Selection, replay_node


def test_the_clock_runs_at_its_speed_stops_and_jumps() -> None:
    clock = ReplayClock(now=100.0, speed=2.0)
    assert clock.position(101.0) == 2.0
    assert clock.wait_s(5.0, 101.0) == 1.5
    clock.pause(True, 101.0)
    assert clock.position(200.0) == 2.0
    assert clock.wait_s(2.5, 200.0) == math.inf
    clock.pause(False, 200.0)
    assert clock.position(200.5) == 3.0
    clock.set_speed(0.5, 200.5)
    assert clock.position(202.5) == 4.0
    clock.seek(0.0, 300.0)
    assert clock.position(301.0) == 0.5


@pytest.mark.parametrize(
    ("topic", "wanted"),
    [
        ("/tripod/joint_states", True),
        ("/tripod/inverse_controller/model_pose", True),
        ("/tripod/mesh/marker", False),
        ("/tripod/step_profile", False),
        ("/tripod/scene/edit", False),
        ("/tripod/scene/proposal", False),
        ("/tripod/scene/structure", True),
        ("/tripod/recorder/enabled", False),
        ("/tripod/simulator/paused", True),
        ("/tripod_2/joint_states", False),
        ("/diagnostics", True),
        ("/rosout", False),
        ("/tripod/joint_trajectory_controller/follow_joint_trajectory/_action/feedback", False),
    ],
)
def test_the_robot_s_topics_and_the_shared_ones_are_taken(topic: str, wanted: bool) -> None:
    assert Selection("/tripod").wants(topic) is wanted


def test_named_topics_are_taken_alone() -> None:
    selection = Selection("/tripod", ["mesh/marker", "/rosout"])
    assert selection.wants("/tripod/mesh/marker")
    assert selection.wants("/rosout")
    assert not selection.wants("/tripod/joint_states")


def test_a_robot_is_recorded_in_the_namespace_of_its_file() -> None:
    recorder = pytest.importorskip("softsim_ros.recording.recorder_node", reason="needs rclpy")
    assert recorder.namespace_of("tripod_mid") == "tripod"
    assert recorder.namespace_of("left_hand") == "left_hand"
    with pytest.raises(RecordingError, match="no robot to record"):
        recorder.namespace_of("no/such/file.yaml")


def shift(value: float) -> bytes:
    from bag_rows import TYPES

    message = TYPES.types["std_msgs/msg/Float64"](data=value)
    return bytes(TYPES.serialize_cdr(message, "std_msgs/msg/Float64"))


def test_commands_go_with_the_starts_and_resets_that_the_shift_tells_of(tmp_path: Path) -> None:
    writer = write(tmp_path / "bag", [(COMMANDS, 10, command([1.0]))])
    writer.add_topic("/tripod/base_shift", "std_msgs/msg/Float64")
    for stamp, value in ((11, 0.0), (20, 0.002), (21, 0.035), (40, 0.0), (50, 0.01)):
        writer.write("/tripod/base_shift", stamp, shift(value))
    writer.write(COMMANDS, 60, command([2.0]))
    writer.close()
    with Bag(tmp_path / "bag") as bag:
        events = list(replay_node.commands(bag, 0))
    assert [(event.stamp_ns, event.service or "command") for event in events] == [
        (10, "command"),
        (20, "start"),
        (40, "reset"),
        (50, "start"),
        (60, "command"),
    ]


def test_a_bag_without_commands_says_so(tmp_path: Path) -> None:
    writer = write(tmp_path / "bag", [])
    writer.add_topic("/tripod/base_shift", "std_msgs/msg/Float64")
    writer.write("/tripod/base_shift", 5, shift(0.0))
    writer.close()
    with Bag(tmp_path / "bag") as bag, pytest.raises(BagError, match="holds no commands"):
        replay_node.command_topics(bag)


def test_a_late_start_begins_with_the_newest_latched_message(tmp_path: Path) -> None:
    from rosbags.interfaces import (
        Qos,
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )

    forever = QosTime(9223372036, 854775807)
    latched = Qos(
        QosHistory.KEEP_LAST,
        1,
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL,
        forever,
        forever,
        QosLiveliness.AUTOMATIC,
        forever,
        False,
    )
    writer = write(tmp_path / "bag", [(COMMANDS, 10, command([1.0])), (COMMANDS, 30, command([2.0]))])
    writer.add_topic("/tripod/base_shift", "std_msgs/msg/Float64", [latched])
    for stamp in (31, 32):
        writer.write("/tripod/base_shift", stamp, shift(float(stamp)))
    writer.write(COMMANDS, 50, command([3.0]))
    writer.close()
    with Bag(tmp_path / "bag") as bag:
        events = list(replay_node.messages(bag, list(bag.topics), 40))
    assert [(event.stamp_ns, event.message.data) for event in events if event.message] == [
        (40, shift(32.0)),
        (50, command([3.0])),
    ]


def test_a_whole_replay_does_not_speak_for_nodes_that_do_not_run(tmp_path: Path) -> None:
    replay = pytest.importorskip("softsim_ros.recording.replay_node", reason="needs rclpy")
    writer = write(tmp_path / "bag", [(COMMANDS, 10, command([1.0]))])
    for topic in ("simulator/paused", "servo_bridge/e_stop_latched"):
        writer.add_topic(f"/tripod/{topic}", "std_msgs/msg/Bool")
        writer.write(f"/tripod/{topic}", 11, bytes([0, 1, 0, 0, 0]))
    writer.close()
    with Bag(tmp_path / "bag") as bag:
        assert len(bag.topics) == 3
        assert replay.whole_topics(bag) == [COMMANDS]
