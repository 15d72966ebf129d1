"""The cable finger on the reference mesh, against the reference simulator and an independent computation."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from softsim_core import Simulation
from softsim_core.base import Backend, Box, MeshFile, Placement, Vector
from softsim_core.physics.actuation.cable import CableDescription
from softsim_core.physics.mechanics import JointLimits
from softsim_core.scene import (
    AttachmentDescription,
    BodyDescription,
    JointDescription,
    MaterialDescription,
    SceneDescription,
    SolverSettings,
)

MILLIMETRES = Placement(scale=1e-3)


def finger(
    data: Path,
    backend: Backend = "auto",
    *,
    pull_point: Vector | None = (0.0, 0.0, 0.0),
    gravity: float = 0.981,
    base: Box | None = None,
    pull_only: bool = False,
) -> SceneDescription:
    """The tutorial's finger in its own y-up frame, in SI: 18 MPa, 0.5 kg, a tenth of gravity."""
    folder = data / "data" / "cable_gripper"
    cable = CableDescription(
        body="finger",
        points=folder / "cable.json",
        placement=MILLIMETRES,
        pull_point=pull_point,
        pull_only=pull_only,
    )
    held = base or Box(center=(0.0, 0.005, 0.01), size=(0.010, 0.030, 0.020))
    return SceneDescription(
        name="finger",
        gravity=(0.0, -gravity, 0.0),
        solver=SolverSettings(rotation="qr", backend=backend),
        bodies=(
            BodyDescription(
                name="finger",
                mesh=MeshFile(file=folder / "finger.vtk", placement=MILLIMETRES),
                material=MaterialDescription(young_modulus=18e6, poisson_ratio=0.3),
                total_mass=0.5,
                mass_distribution="equal",
            ),
        ),
        joints=(JointDescription(name="cable", kind="cable", limits=JointLimits(0.0, 0.1), actuator=cable),),
        attachments=(AttachmentDescription(name="base", body="finger", to="world", box=held),),
    )


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:body")
@pytest.mark.parametrize("backend", [pytest.param("scipy", marks=pytest.mark.exhaustive), "numba"])
def test_the_finger_bends_as_in_the_reference_simulator(reference_dir: Path, backend: Backend) -> None:
    if backend == "numba":
        pytest.importorskip("numba")
    recorded = np.load(reference_dir / "simulator" / "cable_finger.npz")
    sim = Simulation(finger(reference_dir, backend))
    assert sim.actuators[0].length == pytest.approx(1e-3 * float(recorded["cable_initial_length"]), rel=1e-12)
    for k, travel in enumerate(recorded["displacements"]):
        sim.command([1e-3 * travel])
        off, tensions = [], []
        for step in range(303):  # at 10 mm the recorded finger still swings by 3e-4 mm: its phase is within
            sim.step()  # three steps of ours
            if step >= 297:
                off.append(np.abs(1e3 * sim.positions - recorded["positions"][k]).max())
                tensions.append(1e3 * sim.joint_efforts[0])
        best = int(np.argmin(off))
        assert off[best] < 1e-4  # mm
        assert tensions[best] == pytest.approx(recorded["cable_force"][k], rel=1e-3)


@pytest.mark.filterwarnings("ignore:body")
@pytest.mark.parametrize("travel", [1, 5, 10, 20])
def test_equilibria_are_those_of_the_table(reference_dir: Path, travel: int) -> None:
    table = json.loads((reference_dir / "data" / "fixtures" / "finger_cable_reference.json").read_text())
    case = table["cases"]["step3_no_pull_point_g9.8"]
    row = next(row for row in case["table"] if row["d"] == travel)
    base = Box(center=(0.0, 0.0, 0.0), size=(0.02, 0.02, 0.02))
    sim = Simulation(finger(reference_dir, pull_point=None, gravity=9.8e-3, base=base))
    tip = np.flatnonzero(sim.model.rest[:, 0] < -0.095)
    solution = sim.equilibrium([1e-3 * travel])
    assert 1e3 * solution.state.joint_efforts[0] == pytest.approx(row["tension_mN"], rel=1e-3)
    assert 1e3 * solution.state.positions[tip].mean(axis=0) == pytest.approx(row["tip"], abs=2e-3)


@pytest.mark.filterwarnings("ignore:body")
def test_a_cable_that_only_pulls_hangs_slack_where_a_rod_would_push(reference_dir: Path) -> None:
    data = json.loads((reference_dir / "data" / "fixtures" / "finger_cable_reference.json").read_text())
    assert data["cases"]
    up = finger(reference_dir, gravity=-0.981)  # gravity bends the finger towards the cable's side
    rod = Simulation(up).equilibrium([0.0]).state.joint_efforts[0]
    slack = Simulation(finger(reference_dir, gravity=-0.981, pull_only=True)).equilibrium([0.0])
    assert rod < -0.1
    assert slack.state.joint_efforts[0] == 0.0
