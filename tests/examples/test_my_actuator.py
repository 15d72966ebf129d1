"""The example of an actuator of one's own: two springs in series, in statics and dynamics."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from softsim_core import Simulation, load_scene
from softsim_core.base import Backend, ConfigError

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "my_actuator.py"
BAR = 1e5 * 0.02**2 / 0.1
"""Stiffness E A / L of the bar in [N/m]; it is drawn evenly."""
TENDON = 500.0
TAKEN_UP = 0.01
TENSION = TAKEN_UP / (1.0 / BAR + 1.0 / TENDON)
"""Two springs in series."""


def test_the_tension_is_that_of_two_springs_in_series(backend: Backend) -> None:
    simulation = Simulation(load_scene(EXAMPLE), backend)
    state = simulation.equilibrium([TAKEN_UP]).state
    assert state.joint_efforts[0] == pytest.approx(TENSION, rel=1e-9)
    assert state.joint_positions[0] == pytest.approx(TENSION / BAR, rel=1e-9)


def test_steps_come_to_rest_in_this_equilibrium(backend: Backend) -> None:
    scene = load_scene(EXAMPLE).scene
    damped = replace(scene, solver=replace(scene.solver, rayleigh_stiffness=0.05))
    simulation = Simulation(damped, backend)
    simulation.command([TAKEN_UP])
    for _ in range(400):
        simulation.step()
    assert simulation.joint_efforts[0] == pytest.approx(TENSION, rel=1e-6)
    assert simulation.joint_positions[0] == pytest.approx(TENSION / BAR, rel=1e-6)
    assert simulation.actuators[0].value == simulation.joint_positions[0]


def test_it_hangs_slack_where_it_would_have_to_push(backend: Backend) -> None:
    simulation = Simulation(load_scene(EXAMPLE), backend)
    simulation.command([-0.005])
    for _ in range(5):
        simulation.step()
    assert simulation.joint_efforts[0] == 0.0
    assert simulation.joint_positions[0] == pytest.approx(0.0, abs=1e-15)


def test_its_fields_are_keys_of_a_scene_file(tmp_path: Path) -> None:
    load_scene(EXAMPLE)  # registers the kind
    text = """
name: own
bodies:
  - {name: bar, mesh: {file: %s}, material: {young_modulus: 1.0e+5, poisson_ratio: 0.3}, total_mass: 0.02}
joints:
  - name: winch
    kind: elastic_tendon
    elastic_tendon: {body: %s, point: [0.0, 0.0, 0.0], winch: [0.2, 0.0, 0.0], stiffness: 500.0}
"""
    mesh = EXAMPLE.parents[1] / "configs" / "meshes" / "finger_low.vtk"
    file = tmp_path / "own.yaml"
    file.write_text(text % (mesh, "bar"))
    assert load_scene(file).scene.joints[0].actuator.stiffness == 500.0  # type: ignore[union-attr]
    file.write_text(text % (mesh, "bra"))
    with pytest.raises(ConfigError, match="elastic_tendon winch 'bra'; did you mean bar\\? known: bar"):
        load_scene(file)


@pytest.mark.slow
def test_it_prints_its_numbers() -> None:
    done = subprocess.run([sys.executable, EXAMPLE], capture_output=True, text=True, check=True)
    assert done.stdout == f"tip pulled by {1e3 * TENSION / BAR:.3f} mm, tension {TENSION:.4f} N\n"


def test_it_is_short() -> None:
    assert len(EXAMPLE.read_text().splitlines()) <= 80
