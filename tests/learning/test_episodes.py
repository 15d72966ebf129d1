"""A seeded episode's return is the same on every Python version, NumPy and machine, without Gymnasium."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba")

from softsim_core.base import SceneError
from softsim_core.lab.learning import TASKS, Episodes

RETURNS = {"TripodReach-v0": -8.1918195, "TripodBalance-v0": 16.1716706, "CableGripperLift-v0": 1.6996004}
"""Of 20 random actions; the episode has the seed 3."""


@pytest.mark.parametrize("name", RETURNS)
def test_a_seeded_episode_gives_the_same_return_everywhere(name: str) -> None:
    episodes, random, first = Episodes(TASKS[name], 1), np.random.default_rng(5), np.array([0])
    episodes.generators[0] = np.random.default_rng(3)
    episodes.begin(first)
    total = 0.0
    for _ in range(20):
        _, done = episodes.act(first, random.uniform(-0.3, 0.3, (1, len(TASKS[name].low))))
        total += float(done.reward[0])
    assert total == pytest.approx(RETURNS[name], rel=1e-5)


def test_an_environment_measures_what_an_imu_on_the_named_effector_does() -> None:
    """In another gravity, on an effector that is not the first free frame, while the robot moves."""
    arm = {"name": "arm", "body": "silicone", "to": "free"}
    overlay = {
        "gravity": [1.0, 2.0, -5.0],
        "attachments": [{**arm, "box": {"center": [0.03, 0.0, 0.03], "size": [0.012, 0.03, 0.03]}}],
        "effector": "arm",
        "sensors": [{"name": "imu", "kind": "imu", "on": "arm"}],
    }
    reach = TASKS["TripodReach-v0"]
    task = replace(reach, overlay=overlay, asks=(*reach.asks, "effector_rate", "effector_force"))
    assert [each.to for each in task.description().scene.attachments].count("free") == 2
    episodes, random, first = Episodes(task, 1), np.random.default_rng(5), np.array([0])
    episodes.begin(first)
    turned = 0.0
    for _ in range(5):
        episodes.act(first, random.uniform(-0.5, 0.5, (1, 3)))
        moment = episodes._moment(first)
        pose = episodes.batch.call(0, "effector_pose")
        np.testing.assert_array_equal(moment.effector_position[0], pose.position)
        wanted = episodes.batch.call(0, "sensors")["imu"].value
        np.testing.assert_allclose(moment.effector_force[0], wanted[:3], rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(moment.effector_rate[0], wanted[3:], rtol=0.0, atol=1e-12)
        turned = max(turned, float(np.linalg.norm(wanted[3:])))
    assert turned > 0.01


def test_a_task_that_looks_at_an_effector_needs_one() -> None:
    with pytest.raises(SceneError, match=r"asks for effector_position, effector_rotation, and tripod has no"):
        Episodes(replace(TASKS["TripodReach-v0"], overlay={"effector": None}), 1)
