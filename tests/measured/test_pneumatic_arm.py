"""The robot `pneumatic_arm` beside the measured one: how far its tip goes with air in one chamber."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from softsim_core.lab.identification import load_data_set, load_session, session_robot, validate_session

pytestmark = [pytest.mark.slow, pytest.mark.numba]


def test_it_bends_as_far_as_the_measured_one(reference_dir: Path) -> None:
    data = load_data_set("pneumatic_arm", reference_dir / "real" / "data")
    (description,) = data.description.sessions
    session = load_session(data, description)
    result = validate_session(session, session_robot(data.robot, description))
    assert result.predicted.sum() == 18
    pressures, ahead = session.table.numbers("p_mbar"), -session.measured[:, 0, 0]
    for pressure, real, off in zip(pressures, ahead, result.raw[:, 0], strict=True):
        assert abs(off[0]) < max(0.12 * real, 0.35e-3), f"{pressure:g} mbar"
        assert np.linalg.norm(off) < max(0.15 * real, 0.5e-3), f"{pressure:g} mbar, with height and side"
