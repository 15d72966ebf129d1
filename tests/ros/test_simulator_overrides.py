"""Values laid over the scene's file while it runs: it begins anew with them, wrong ones change nothing."""

from __future__ import annotations

import json
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.shared_robot("tripod")]

from geometry_msgs.msg import PoseArray  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import String  # noqa: E402

MOVED = "joints: [{name: servo_0, base: {translation: [-0.0641, 0.01, 0.0]}}]"


def test_a_part_moves_and_a_wrong_value_moves_nothing(tripod: Any, spin_until: Any) -> None:
    robot = tripod
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    structures = robot.client.collect(String, "scene/structure", latched)
    frames = robot.client.collect(PoseArray, "frames")
    states = robot.client.collect(JointState, "joint_states")

    def until(condition: Any) -> bool:
        return bool(spin_until(condition))

    assert until(lambda: structures and frames)
    begun = json.loads(structures[-1].data)
    assert begun["overrides"] == ""
    base = begun["frames"].index("servo_0")
    assert frames[-1].poses[base].position.y == pytest.approx(0.0, abs=1e-9)

    assert robot.set_parameters(overrides=MOVED) == (True, "")
    assert until(lambda: frames[-1].poses[base].position.y == pytest.approx(0.01))
    assert until(lambda: json.loads(structures[-1].data)["overrides"] == MOVED)

    for wrong, words in (
        ("joints: [{name: servo_0, bas: {}}]", "did you mean base"),
        ("[1]", "must hold `key: value` lines"),
        ("attachments: [{name: centre, sphere: {center: [9, 9, 9], radius: 0.01}}]", "centre"),
    ):
        successful, reason = robot.set_parameters(overrides=wrong)
        assert not successful
        assert reason.startswith("overrides refused: ")
        assert words in reason
    assert robot.get_parameter("overrides") == MOVED
    heard = len(states)
    assert until(lambda: len(states) > heard + 5)  # goes on, not paused
    assert frames[-1].poses[base].position.y == pytest.approx(0.01)

    assert robot.set_parameters(overrides="dt: 0.005") == (True, "")
    assert until(lambda: json.loads(structures[-1].data)["dt"] == 0.005)

    assert robot.set_parameters(robot="tripod") == (True, "")
    assert until(lambda: frames[-1].poses[base].position.y == pytest.approx(0.0, abs=1e-9))
    assert robot.get_parameter("overrides") == ""
