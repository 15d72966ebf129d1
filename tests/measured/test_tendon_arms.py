"""Measured tendon arms: errors of the shipped models on rows in which all three segments move."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from softsim_core import load_scene
from softsim_core.lab.identification import (
    load_calibration,
    load_data_set,
    load_session,
    replace_expressions,
    session_robot,
    validate_session,
)
from softsim_core.physics.actuation.cable import CableDescription

MOST_MM = {
    "ftdcr_v4": {"ftdcr_v4": 7.5, "ftdcr_v4_measured": 6.5},
    "ftdcr_v6": {"ftdcr_v6": 30.0, "ftdcr_v6_measured": 10.0},
}
"""Largest root mean square in [mm] of held-out rows, of the arm as described and as identified."""


@pytest.mark.slow
@pytest.mark.reference
@pytest.mark.parametrize("name", MOST_MM)
def test_the_identified_arm_is_nearer_than_the_described_one(name: str, reference_dir: Path) -> None:
    data = load_data_set(name, reference_dir / "tendon_arms" / "ftdcr" / "data")
    whole = load_session(data, data.description.sessions[0])
    rows = np.concatenate([np.flatnonzero(whole.training)[::12], np.flatnonzero(~whole.training)[::3]])
    session, errors = whole.part(np.sort(rows)), []
    for robot, most in MOST_MM[name].items():
        result = validate_session(session, session_robot(robot, session.description))
        assert result.predicted.mean() > 0.95
        errors.append(1e3 * result.of(result.evaluated).rms)
        assert errors[-1] < most
    assert errors[1] < 0.9 * errors[0]


@pytest.mark.parametrize("name", MOST_MM)
def test_a_calibration_begins_at_the_described_arm(name: str) -> None:
    description, _ = load_calibration(name)
    start = {each.name: each.start for each in description.parameters}
    given = {f"slack_{k}{t}": 0.0 for k in range(3) for t in range(3)}
    made = load_scene(name, replace_expressions(description.overlay, start | given))
    drawn = load_scene(name)
    assert made.scene.bodies == drawn.scene.bodies
    for one, other in zip(made.joints, drawn.joints, strict=True):
        assert isinstance(one.actuator, CableDescription)
        assert isinstance(other.actuator, CableDescription)
        np.testing.assert_allclose(np.array(one.actuator.points), np.array(other.actuator.points), rtol=1e-9)
        assert one.actuator.compliance == pytest.approx(other.actuator.compliance, rel=0.03)
