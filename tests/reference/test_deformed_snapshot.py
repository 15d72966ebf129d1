"""tripodDeformed.vtu, written by the reference simulator itself, is an equilibrium of ours, node by node."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from reference_scenes import from_reference

from softsim_core.base import Array, Backend, MeshFile, Placement
from softsim_core.physics.dynamics import make_stepper, solve_static
from softsim_core.physics.mechanics import FIXED, Control, Model, Parameters, State
from softsim_core.physics.mesh import read_tets
from softsim_core.scene import BodyDescription, MaterialDescription, SceneDescription, SolverSettings
from softsim_core.scene.building import build

pytestmark = [pytest.mark.reference, pytest.mark.filterwarnings("ignore:body silicone")]

Snapshot = tuple[Model, Parameters, State, Array]


@pytest.fixture(scope="module")
def snapshot(reference_dir: Path) -> Snapshot:
    """Model with held arms, parameters, a state with the arms in place and the rest undeformed, answer."""
    folder = reference_dir / "data"
    fixture = json.loads((folder / "fixtures" / "tripodDeformed_fixture.json").read_text())
    material = fixture["material"]
    body = BodyDescription(
        name="silicone",
        mesh=MeshFile(
            file=folder / "tripod" / fixture["mesh"].split()[0],
            placement=Placement(scale=0.001, rotation_deg=(180.0, 0.0, 90.0)),
        ),
        material=MaterialDescription(
            young_modulus=1e3 * material["young_modulus"], poisson_ratio=material["poisson_ratio"]
        ),
        total_mass=fixture["total_mass"],
        mass_distribution="equal",
    )
    gravity = tuple(from_reference(np.array(fixture["gravity"])).tolist())
    solver = SolverSettings(rotation="qr", rayleigh_stiffness=0.01)
    built = build(SceneDescription(name="snapshot", gravity=gravity, solver=solver, bodies=(body,)))
    held = np.concatenate([arm["node_ids"] for arm in fixture["arms"]])
    region_of_node = built.model.region_of_node.copy()
    region_of_node[held] = FIXED
    model = replace(built.model, region_of_node=region_of_node)
    expected = from_reference(
        1e3 * read_tets(folder / "tripod" / "tripodDeformed.vtu", Placement(scale=0.001)).points
    )
    state = model.rest_state()
    free = model.free_nodes
    state.positions[free] += (expected - model.rest)[held].mean(axis=0)
    state.positions[held] = expected[held]
    return model, built.parameters, state, expected


def test_statics_find_the_snapshot_within_a_micrometre(snapshot: Snapshot) -> None:
    model, parameters, start, expected = snapshot
    assert np.linalg.norm(start.positions - expected, axis=1).max() > 0.008  # the start is no answer
    solution = solve_static(model, start, Control(np.zeros(0), np.zeros_like(model.rest)), parameters)
    assert np.abs(solution.state.positions - expected).max() < 1e-6


def test_dynamics_settle_in_the_snapshot(snapshot: Snapshot, backend: Backend) -> None:
    model, parameters, start, expected = snapshot
    stepper = make_stepper(model, backend)
    state = model.rest_state()
    state.copy_from(start)
    control = Control(np.zeros(0), np.zeros_like(model.rest))
    for _ in range(400):
        stepper.step(state, control, parameters)
        if np.abs(state.velocities).max() < 1e-8:
            break
    assert np.abs(state.velocities).max() < 1e-8
    assert np.abs(state.positions - expected).max() < 1e-6
