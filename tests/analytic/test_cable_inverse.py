"""Inverse control of a finger bent by cables: derivatives against equilibria, goals reached by pulling."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cable_scenes import POINTS, bent_bar, cable_joint

from softsim_core import Pose, Simulation
from softsim_core.control.inverse import InverseController, analytic_sensitivity, sampled_sensitivity

OTHER = tuple((x, 0.004, -0.003) for x, _, _ in POINTS)
THIRD = tuple((x, -0.004, -0.003) for x, _, _ in POINTS)


def finger() -> Simulation:
    """A bar with three cables around its axis; its tip is the effector."""
    cables = (cable_joint("top"), cable_joint("left", points=OTHER), cable_joint("right", points=THIRD))
    return Simulation(bent_bar(*cables, tip=True, gravity=(0.0, 0.0, -1.0)))


def tip_goal(travels: tuple[float, ...]) -> Pose:
    """Where the tip is in the equilibrium of these travels."""
    sim = finger()
    sim.settle(travels)
    pose = sim.effector_pose
    assert pose is not None
    return pose


@pytest.mark.slow
@pytest.mark.parametrize("travels", [(0.006, 0.004, 0.003), (0.008, 0.003, 0.003)])
def test_sensitivity_is_that_of_equilibria(travels: tuple[float, ...]) -> None:
    sim = finger()
    sim.settle(travels)
    assert (sim.joint_efforts > 0.0).all()
    exact, sampled = analytic_sensitivity(sim), sampled_sensitivity(sim, 1e-6)
    for a, b in ((exact.effector, sampled.effector), (exact.effort, sampled.effort)):
        assert np.abs(a - b).max() < 1e-3 * np.abs(b).max()


@pytest.mark.numba
@pytest.mark.parametrize("travels", [(0.006, 0.004, 0.003), (0.002, 0.005, 0.002), (0.0, 0.003, 0.006)])
def test_a_reachable_tip_goal_is_reached_by_pulling_only(travels: tuple[float, ...]) -> None:
    pytest.importorskip("daqp")
    goal = tip_goal(travels)
    settings = replace(finger().robot.inverse, orientation_weights=(0.0, 0.0, 0.0))
    controller = InverseController(finger().scene, settings)
    controller.start([0.001, 0.001, 0.001], 0.0)
    controller.set_goal(goal)
    for _ in range(300):
        report = controller.tick()
        assert (report.command >= 0.0).all()
        assert (controller.model.joint_efforts >= 0.0).all()
        if report.status == "reached":
            break
    assert report.residual_m < 1e-4
