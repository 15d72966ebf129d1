"""A beam that a hand lets go: its damping is found although the hand is not in the model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softsim_core import ConfigError, Simulation, load_data_set, load_scene, load_session
from softsim_core.base import Array, DataError
from softsim_core.lab.identification import (
    Calibration,
    calibrate,
    data_of,
    load_calibration,
    release_errors,
    session_robot,
    validate_session,
)

ROBOT = """
name: beam
dt: 0.01
gravity: [0.0, 0.0, -9.81]
solver: {time_integration: bossak, rayleigh_mass: 5.0}
bodies:
  - name: rod
    rod:
      centreline: [[0, 0, 0], [0.1, 0, 0]]
      section: {shape: rectangle, size: [0.03, 0.03]}
      elements: 3
    material: {law: rod, young_modulus: 3.0e+5, poisson_ratio: 0.45}
    density: 1070
attachments:
  - {name: clamp, body: rod, to: world, end: start}
  - {name: tip, body: rod, to: free, end: end, frame: {translation: [0.1, 0, 0]}}
effector: tip
"""
DATA_SET = """
name: bench
robot: beam.yaml
sessions:
  - name: let_go
    file: let_go.csv
    sensors: [{name: marker, columns: [x_m, y_m, z_m], displacement: true}]
    time: {column: t_s, first: 0.15, last: 2.0, start: rest, release: RELEASE, most_delay: 0.06}
"""
CALIBRATION = """
name: beam
data_set: .
parameters:
  - {name: young, start: 260.0, lower: 100.0, upper: 600.0, unit: kPa}
  - {name: mass_damping, start: 2.0, lower: 0.1, upper: 12.0, unit: 1/s}
overlay:
  solver: {rayleigh_mass: "= mass_damping"}
  bodies: [{name: rod, material: {young_modulus: "= 1000 * young"}}]
"""
NOISE = 2e-5
"""Of a marker, in [m]."""


def bench(folder: Path, hand: float, late: float, release: str, seed: int = 0) -> Path:
    """A folder with beam, measurements and calibration.

    Args:
        folder: Where.
        hand: In which time in [s] the hand that bears the weight of the beam gives way.
        late: By how much the measured time is late, in [s].
        release: What the data set says of it.
        seed: Of the noise.
    """
    (folder / "beam.yaml").write_text(ROBOT)
    simulation = Simulation(load_scene(folder / "beam.yaml"))
    weight = simulation.model.mass[:, None] * np.array([0.0, 0.0, -9.81])
    rows = []
    for _ in range(240):
        pose = simulation.effector_pose
        assert pose is not None
        rows.append((simulation.time, *pose.position))
        simulation.forces[:] = -weight * np.clip(1.0 - simulation.time / hand, 0.0, 1.0)
        simulation.step()
    table = np.array(rows)
    still = np.repeat(table[:1], 20, axis=0)
    still[:, 0] = np.linspace(-0.2, -0.01, 20)
    table = np.concatenate([still, table])
    table[:, 0] += late
    table[:, 1:] += NOISE * np.random.default_rng(seed).standard_normal((len(table), 3))
    np.savetxt(folder / "let_go.csv", table, "%.9g", ",", header="t_s,x_m,y_m,z_m", comments="")
    (folder / "dataset.yaml").write_text(DATA_SET.replace("RELEASE", release))
    (folder / "calibration.yaml").write_text(CALIBRATION)
    return folder


def fitted(folder: Path) -> Calibration:
    description, file = load_calibration(folder)
    return calibrate(description, data_of(description, file, None))


@pytest.mark.slow
@pytest.mark.numba
@pytest.mark.parametrize(("hand", "late"), [(0.07, 0.0), (0.09, 0.02)])
def test_damping_is_found_whatever_the_hand_did(tmp_path: Path, hand: float, late: float) -> None:
    young, mass_damping = fitted(bench(tmp_path, hand, late, "unknown")).values
    assert young == pytest.approx(300.0, rel=5e-3)
    assert mass_damping == pytest.approx(5.0, rel=0.03)


@pytest.mark.slow
@pytest.mark.numba
def test_with_a_release_taken_for_known_damping_makes_up_for_the_hand(tmp_path: Path) -> None:
    """It shows what the test above is for."""
    assert fitted(bench(tmp_path, 0.07, 0.0, "known")).values[1] > 1.1 * 5.0


def swing(times: Array, size: float, phase: float, decay: float = 2.5) -> Array:
    """A swing of two sensors in [m], shape (k, 2, 3), that sinks and creeps."""
    along = size * np.exp(-decay * times) * np.cos(48.0 * times + phase) - 1e-3 * (1.0 - np.exp(-times))
    return np.stack([np.outer(along, [0.1, 0.0, -1.0]), np.outer(along, [0.0, 0.2, -0.9])], axis=1)


def test_amplitude_and_phase_are_taken_away_and_nothing_else() -> None:
    times, rows = np.arange(0.0, 3.0, 0.01), np.ones(300, dtype=np.bool_)
    model = swing(times, 8e-3, 0.3)
    errors = model - swing(times, 6e-3, 0.6)
    released = release_errors(times, model, errors, rows)
    assert released is not None
    assert np.abs(errors - released).max() < 0.01 * np.abs(errors).max()
    errors = model - swing(times, 8e-3, 0.3, decay=3.0)
    released = release_errors(times, model, errors, rows)
    assert released is not None
    assert (errors - released).std() > 0.3 * errors.std()
    assert release_errors(times, 0.0 * model, errors, rows) is None


@pytest.mark.numba
def test_a_model_that_does_not_ring_is_refused(tmp_path: Path) -> None:
    data = load_data_set(bench(tmp_path, 0.07, 0.0, "unknown"))
    (session,) = data.description.sessions
    loaded = load_session(data, session)
    result = validate_session(loaded, session_robot(data.robot, session))
    assert result.fitted_errors()[loaded.fitting].std() < result.aligned[loaded.fitting].std()
    still = replace(result, positions=np.zeros_like(result.positions))
    with pytest.raises(DataError, match="let_go: its release is unknown, but the model does not ring"):
        still.fitted_errors()


def test_only_what_is_let_go_has_a_release(tmp_path: Path) -> None:
    given = DATA_SET.replace("rest, release: RELEASE", "equilibrium, release: unknown")
    (tmp_path / "dataset.yaml").write_text(given)
    with pytest.raises(ConfigError, match="release: must be known, or give start: rest, not 'unknown'"):
        load_data_set(tmp_path)
