"""Inverse control of chambers by pressure, by volume and on a line of air: derivatives, and goals reached."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from cable_scenes import cable_joint
from small_scenes import slab
from test_chambers import SIDE, hollow, inflated

from softsim_core import Simulation
from softsim_core.base import Placement
from softsim_core.control.inverse import (
    InverseController,
    PositionTask,
    analytic_sensitivity,
    sampled_sensitivity,
    solve_pose,
)
from softsim_core.scene import InverseSettings, SceneDescription

LINE = {"line_volume": 3e-6, "exponent": 1.3, "line_compliance": 2e-11}
TIP = Placement(translation=(0.06, 0.0, 0.0))
SETTINGS = InverseSettings(position_weights=(1.0, 0.0, 1.0), effort_weight=0.0)


def driven(control: str = "pressure", cable: bool = True, **line: Any) -> SceneDescription:
    """A hollow cube that is held at one side, with air and a cable in it; the other side is its tip."""
    described = inflated(hollow(), control, backend="scipy", **line)
    (air,) = described.joints
    joints = [air]
    if cable:
        along = tuple((x, 0.0, 0.015) for x in (-0.012, 0.0, 0.012))
        joints.append(cable_joint("cable", body="body", points=along))
    return replace(
        described,
        joints=tuple(joints),
        attachments=(*described.attachments, replace(slab("tip", "free", 0.5 * SIDE), frame=TIP)),
        effector="tip",
    )


@pytest.mark.parametrize(
    ("control", "line", "given", "step"),
    [
        ("pressure", {}, 4e3, 10.0),
        ("volume", {}, 1.5e-6, 1e-8),
        ("volume", LINE, 3e-6, 1e-8),
        ("volume", LINE, -1e-6, 1e-8),
    ],
)
@pytest.mark.parametrize("backend", ["scipy", pytest.param("numba", marks=pytest.mark.numba)])
def test_derivatives_are_those_of_equilibria(
    control: str, line: dict[str, Any], given: float, step: float, backend: str
) -> None:
    """Of the tip, of the pressure and of the cable's tension, beside a cable that keeps its way."""
    if backend == "numba":
        pytest.importorskip("numba")
    simulation = Simulation(driven(control, **line), backend)  # type: ignore[arg-type]
    simulation.settle([given, 0.0006])
    assert simulation.joint_efforts[1] > 0.05
    exact, sampled = analytic_sensitivity(simulation), sampled_sensitivity(simulation, np.array([step, 1e-6]))
    for a, b in ((exact.effector, sampled.effector), (exact.effort, sampled.effort)):
        for k in range(2):
            assert np.abs(a[:, k] - b[:, k]).max() < 2e-3 * np.abs(b[:, k]).max()
        np.testing.assert_allclose(a[:, 1], b[:, 1], rtol=1e-2, atol=1e-4 * np.abs(b[:, 1]).max())


@pytest.mark.parametrize(("control", "unit"), [("pressure", 6e3), ("volume", 2e-6)])
def test_statics_find_the_command_for_a_place_of_the_tip(control: str, unit: float) -> None:
    pytest.importorskip("daqp")
    described = driven(control, cable=False)
    there = Simulation(described).equilibrium([0.7 * unit]).state.frame_positions[0]
    found = solve_pose(Simulation(described), PositionTask(there, np.ones(3)))
    assert found.reachable
    assert found.joints[0] == pytest.approx(0.7 * unit, rel=0.02)


@pytest.mark.parametrize("control", ["pressure", "volume"])
def test_a_goal_is_reached_in_real_time(control: str) -> None:
    """By air and a cable together: units ten orders of magnitude apart in one program."""
    pytest.importorskip("daqp")
    given = {"pressure": [5e3, 0.0005], "volume": [1.5e-6, 0.0005]}[control]
    described = driven(control, **(LINE if control == "volume" else {}))
    plant = Simulation(described)
    plant.settle(given)
    goal = plant.effector_pose
    assert goal is not None
    assert np.linalg.norm(goal.position - TIP.translation) > 1e-3
    controller = InverseController(described, SETTINGS)
    controller.start([0.0, 0.0], 0.0)
    controller.set_goal(goal)
    for _ in range(120):
        report = controller.tick()
        if report.status == "reached":
            break
    assert report.status == "reached", report.message
    assert report.residual_m < 1e-4
    assert report.sensitivity_age == 0
