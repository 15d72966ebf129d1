"""Computed shapes of two rods under their weight and two wrenches: the models of the data set `sorosim`."""

from __future__ import annotations

from pathlib import Path

import pytest

from softsim_core.lab.identification import (
    SessionDescription,
    load_data_set,
    load_session,
    session_robot,
    validate_session,
)

pytest.importorskip("numba")

LARGEST_MM = {"springsteel": 0.6, "tpu": 0.45}
"""A thousandth of the length of each rod in [mm]; 0.05 more for one shape of TPU, as loads are rounded."""


def session_of(name: str, folder: Path | None = None) -> tuple[str, SessionDescription]:
    """Return the model and the description of a session."""
    data = load_data_set("sorosim", folder)
    return data.robot, next(each for each in data.description.sessions if each.name == name)


@pytest.mark.slow
@pytest.mark.reference
@pytest.mark.parametrize("every", [25, pytest.param(1, marks=pytest.mark.exhaustive)])
@pytest.mark.parametrize("name", LARGEST_MM)
def test_rods_have_the_computed_shapes(name: str, every: int, reference_dir: Path) -> None:
    folder = reference_dir / "tendon_arms" / "ftdcr" / "data"
    robot, description = session_of(name, folder)
    session = load_session(load_data_set("sorosim", folder), description, every=every)
    result = validate_session(session, session_robot(robot, description))
    assert result.predicted.all()
    assert result.of(result.evaluated).max < LARGEST_MM[name]


def test_both_rods_are_those_of_the_source() -> None:
    for name, length, radius in (("springsteel", 0.6, 0.8e-3), ("tpu", 0.4, 5e-3)):
        robot, description = session_of(name)
        scene = session_robot(robot, description).scene
        rod = scene.bodies[0].rod
        assert rod is not None
        assert rod.centreline == ((0.0, 0.0, 0.0), (length, 0.0, 0.0))
        assert rod.section.size == (2 * radius, 2 * radius)
        points = {joint.name: getattr(joint.actuator, "point", None) for joint in scene.joints}
        assert points["gravity_x"] is None
        assert points["mid_mz"] == points["mid_fx"] == (length / 2, 0.0, 0.0)
        assert points["tip_mz"] == points["tip_fx"] == (length, 0.0, 0.0)
