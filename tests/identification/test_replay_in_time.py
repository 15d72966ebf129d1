"""Commands in time: the model does again what was recorded of it, and late sensors are found to be late."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from softsim_core import Simulation, load_data_set, load_scene, load_session, session_robot, validate_session
from softsim_core.base import Array
from softsim_core.lab.identification import SessionResult

pytestmark = pytest.mark.slow

DESCRIPTION = """
name: steps
robot: tripod
sessions:
  - name: steps
    file: steps.csv
    commands: {columns: [a, b, c], unit: rad}
    sensors: [{name: tracker, columns: [x_mm, y_mm, z_mm], unit: mm}]
    time: {column: t_ms, unit: ms, most_delay: 0.05}
"""


@cache
def motion() -> tuple[Array, Array, Array]:
    """Times (k,) in [s], commands given then (k, 3) in [rad], effector positions then (k, 3) in [m]."""
    robot = load_scene("tripod")
    simulation = Simulation(robot)
    goals = np.array([[-1.2, -1.2, -1.2], [-0.9, -1.4, -1.2], [-1.5, -1.0, -0.8], [-1.2, -1.2, -1.2]])
    simulation.settle(goals[0], robot.start_shift)
    rows = []
    for k in range(120):
        goal, pose = goals[k // 30], simulation.effector_pose
        assert pose is not None
        rows.append((simulation.time, *goal, *pose.position))
        simulation.command(goal)
        simulation.step()
    table = np.array(rows)
    return table[:, 0], table[:, 1:4], table[:, 4:]


def beside(folder: Path, late: float, every: int = 1) -> SessionResult:
    times, commands, positions = motion()
    seen = np.stack([np.interp(times - late, times, each) for each in positions.T], axis=1)
    names = "t_ms,a,b,c,x_mm,y_mm,z_mm"
    table = np.column_stack([1e3 * times, commands, 1e3 * seen])[::every]
    np.savetxt(folder / "steps.csv", table, fmt="%.9f", delimiter=",", header=names, comments="")
    (folder / "dataset.yaml").write_text(DESCRIPTION)
    data = load_data_set(folder)
    (session,) = data.description.sessions
    return validate_session(load_session(data, session), session_robot(data.robot, session))


def test_the_same_motion_comes_out(tmp_path: Path) -> None:
    result = beside(tmp_path, 0.0)
    assert result.of(result.evaluated, raw=True).count == 120
    assert result.of(result.evaluated, raw=True).max < 1e-8
    assert result.alignment is not None
    assert abs(result.alignment.delay) < 1e-4


def test_rows_may_be_rarer_than_steps(tmp_path: Path) -> None:
    result = beside(tmp_path, 0.0, every=5)
    assert result.of(result.evaluated, raw=True).count == 24
    assert result.of(result.evaluated, raw=True).max < 1e-8  # commands change at rows that are left


def test_a_late_sensor_is_found_late(tmp_path: Path) -> None:
    result = beside(tmp_path, 0.02)
    assert result.alignment is not None
    assert result.alignment.delay == pytest.approx(0.02, abs=2e-4)
    assert result.of(result.evaluated).max < 0.05 * result.of(result.evaluated, raw=True).max
    (measured, model) = result.rest_values()["tracker"]
    assert np.abs(measured - model).max() < 1e-5
