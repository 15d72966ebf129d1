"""Simulators started with other parameters or scenes than the Tripod's own, in another process."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.slow]

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus  # noqa: E402
from diagnostics import diagnostic_values  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from softsim_core.scene.io import config_file  # noqa: E402
from softsim_node import LATCHED  # noqa: E402


def test_a_simulator_starts_with_other_parameters(start_robot: Any, spin_until: Any) -> None:
    """Values out of range are refused, simulated time is published, overrides hold, nothing is edited."""
    overrides = '"gravity: [0, 0, -1.5]"'
    robot = start_robot(
        out_of_range="refuse", publish_clock=True, speed=2.0, overrides=overrides, editing=False
    )
    try:

        def services() -> dict[str, list[str]]:
            return dict(robot.client.offered("simulator", "/tripod", services=True))

        assert spin_until(lambda: "/tripod/simulator/reload" in services())
        assert not [name for name in services() if name.startswith("/tripod/simulator/edit")]
        structures = robot.client.collect(String, "scene/structure", LATCHED)
        assert spin_until(lambda: structures)
        assert json.loads(structures[-1].data)["overrides"] == "gravity: [0, 0, -1.5]"
        states = robot.client.collect(JointState, "joint_states")
        assert spin_until(lambda: states)
        robot.command([-0.3, -0.3, -9.0])
        assert robot.warns("command -9.0 for joint servo_2 refused: allowed is [-2.0225, -0.0255]")
        states.clear()
        assert spin_until(lambda: len(states) > 5)
        assert {position for state in states for position in state.position} == {0.0}
        assert states[-1].header.stamp.sec < 1000  # not the wall clock
        clocks = robot.client.collect(Clock, "/clock")
        assert spin_until(lambda: len(clocks) > 50)
        times = np.array([clock.clock.sec + 1e-9 * clock.clock.nanosec for clock in clocks])
        assert (np.diff(times) > 0.0).all()
        np.testing.assert_allclose(times / 0.01, np.rint(times / 0.01), atol=1e-6)  # whole steps
    finally:
        assert robot.process.end() == 0


def test_the_mid_mesh_takes_less_than_400_mb(start_robot: Any, spin_until: Any) -> None:
    robot = start_robot(robot="tripod_mid")
    try:
        reports = robot.client.collect(DiagnosticArray, "/diagnostics")
        assert spin_until(lambda: reports)
        assert 20.0 < float(diagnostic_values(reports[-1], "tripod/simulator")["memory_mb"]) < 400.0
    finally:
        assert robot.process.end() == 0


OVERLOADED = """
from softsim_core.scene import Scene
from softsim_core import Controller
from softsim_core.robots import tripod

def create_scene(scene: Scene) -> None:
    scene.name = "tripod"
    scene.add(tripod())
    scene.add(Controller(on_begin=push))

def push(simulation):
    if simulation.step_count == 30:
        simulation.forces[:] = 1.0e12
"""


def test_a_diverging_simulation_stops_at_its_last_good_state(
    start_robot: Any, spin_until: Any, tmp_path: Path
) -> None:
    file = tmp_path / "overloaded.py"
    file.write_text(OVERLOADED)
    robot = start_robot(robot=str(file))
    try:
        begun, sentence = robot.trigger("edit/begin")
        assert not begun
        assert "is a program, which is edited by hand" in sentence
        reports = robot.client.collect(DiagnosticArray, "/diagnostics")
        states = robot.client.collect(JointState, "joint_states")
        assert robot.warns("diverged at step 31 (t = 0.310 s)")
        assert robot.warns("paused at the last good state")

        def stopped() -> bool:
            return any(
                report.status[0].level == DiagnosticStatus.ERROR
                and diagnostic_values(report, "tripod/simulator").get("state") == "stopped"
                for report in reports
            )

        assert spin_until(stopped)
        states.clear()
        assert spin_until(lambda: len(states) > 1)
        assert np.isfinite([*states[-1].position, *states[-1].effort]).all()
        success, sentence = robot.trigger("step")
        assert not success
        assert "diverged" in sentence
        assert robot.trigger("reset")[0]
        assert robot.trigger("step")[0]
    finally:
        assert robot.process.end() == 0


CUBE = """
extends: {parent}
name: tripod
contact: {contact}
"""


def test_the_diagnostics_tell_how_well_contacts_are_solved(
    start_robot: Any, spin_until: Any, tmp_path: Path
) -> None:
    file, parent = tmp_path / "cube.yaml", config_file("scenes/gripper_step_1.yaml")
    file.write_text(CUBE.format(parent=parent, contact="{}"))
    robot = start_robot(robot=str(file))
    try:
        reports = robot.client.collect(DiagnosticArray, "/diagnostics")

        def first(key: str, least: int) -> dict[str, str]:
            """The first report in which a value is as large as that."""
            every = [diagnostic_values(report, "tripod/simulator") for report in reports]
            return next((each for each in every if int(each.get(key, 0)) >= least), {})

        assert spin_until(lambda: first("contacts", 4))  # corners on the floor
        values = first("contacts", 4)
        assert float(values["contact_residual_m"]) < 1e-6
        assert values["unsolved_contact_steps"] == "0"
        file.write_text(CUBE.format(parent=parent, contact="{tolerance: 1.0e-30, iterations: 1}"))
        assert robot.trigger("reload")[0]
        assert spin_until(lambda: first("unsolved_contact_steps", 1))
        warnings = [report.status[0] for report in reports if report.status[0].level == DiagnosticStatus.WARN]
        assert any("contacts solved only to" in each.message for each in warnings)
    finally:
        assert robot.process.end() == 0
