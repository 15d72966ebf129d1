"""Inverse control of the cable finger: the tip is led to goals by a cable that only pulls."""

from __future__ import annotations

import numpy as np
import pytest

from softsim_core import Simulation, load_scene
from softsim_core.control.inverse import InverseController


@pytest.mark.parametrize("travel", [0.004, 0.012, 0.025])
@pytest.mark.slow
def test_the_tip_reaches_goals_that_the_cable_can_reach(travel: float) -> None:
    scene = load_scene("cable_finger")
    there = Simulation(scene)
    there.settle([travel])
    controller = InverseController(scene)
    controller.start([0.0])
    controller.set_goal(there.effector_pose)
    for _ in range(150):
        report = controller.tick()
        assert 0.0 <= report.command[0] <= 0.035
    assert report.residual_m < 1e-6
    assert report.command[0] == pytest.approx(travel, abs=1e-6)


def test_a_goal_that_would_need_a_push_leaves_the_cable_slack() -> None:
    scene = load_scene("cable_finger")
    controller = InverseController(scene)
    controller.start([0.0])
    pose = Simulation(scene).effector_pose
    assert pose is not None
    below = type(pose)(pose.position - np.array([0.0, 0.0, 0.02]), pose.quaternion_xyzw)
    controller.set_goal(below)
    for _ in range(50):
        report = controller.tick()
    assert report.command[0] == pytest.approx(0.0, abs=1e-9)
    assert report.status != "reached"
