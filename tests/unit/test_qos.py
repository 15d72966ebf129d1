"""Quality of service: sensors that publish best effort are heard wherever a measurement comes in."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from rclpy.qos import ReliabilityPolicy

import softsim_ros
from softsim_node import MEASURED

SUBSCRIPTION = re.compile(
    r"create_subscription\(\s*\w+,\s*\"(?P<topic>[\w/]+)\",[^)]*?,\s*(?P<qos>[\w.]+)[,)]"
)
TOPICS = {"imu", "effector_pose", "joint_states", "applied_joint_states", "bodies/poses"}


def test_a_measurement_is_asked_for_best_effort() -> None:
    assert MEASURED.reliability == ReliabilityPolicy.BEST_EFFORT


@pytest.mark.parametrize("folder", ["inverse", "policy", "observer", "client", "."])
def test_no_node_asks_more_of_a_measurement(folder: str) -> None:
    root = Path(softsim_ros.__file__).parent / folder
    found = [
        (path.name, match["topic"], match["qos"])
        for path in sorted(root.glob("*.py"))
        for match in SUBSCRIPTION.finditer(path.read_text(encoding="utf-8"))
        if match["topic"] in TOPICS
    ]
    assert all(qos == "MEASURED" for _, _, qos in found), found
