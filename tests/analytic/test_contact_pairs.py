"""Friction per pair, what a report tells of each contact, and what runs away."""

from __future__ import annotations

import math

import numpy as np
import pytest
from contact_scenes import downhill, loose, touching

from softsim_core import Simulation
from softsim_core.base import FieldError, Placement, SceneError, SolverDivergedError
from softsim_core.physics.contact import PairFriction
from softsim_core.physics.contact.detection import detector
from softsim_core.physics.mesh import Shape
from softsim_core.scene import RigidBodyDescription, SceneDescription

FLOOR = RigidBodyDescription(
    name="floor", shape=Shape(box=(1.0, 1.0, 0.02)), pose=Placement(translation=(0.0, 0.0, -0.01))
)
HALF = Shape(box=(0.02, 0.02, 0.02))


def two_boxes(*pairs: PairFriction) -> SceneDescription:
    """Two boxes side by side on a slope of 20 degrees; friction is 0.1 but for the pairs."""
    other = RigidBodyDescription(
        name="other", shape=HALF, mass=0.03, pose=Placement(translation=(0.0, 0.1, 0.011))
    )
    return touching(
        FLOOR,
        loose("box", HALF, 0.011),
        other,
        gravity=downhill(math.radians(20.0)),
        friction=0.1,
        contact={"friction_pairs": pairs},
    )


def test_one_box_sticks_and_the_other_slides_where_only_one_has_the_friction() -> None:
    sim = Simulation(two_boxes(PairFriction(between=("floor", "box"), friction=0.9)))
    for _ in range(50):
        sim.step()
    box, other = (pose.position[0] for pose in sim.rigid_poses[1:])
    slid = 0.5 * 9.81 * (math.sin(math.radians(20.0)) - 0.1 * math.cos(math.radians(20.0))) * 0.5**2
    assert abs(box) < 1e-6
    assert other == pytest.approx(slid, rel=0.05)


def test_unknown_names_and_wrong_values_of_a_pair_are_refused() -> None:
    with pytest.raises(SceneError, match=r"body of contact\.friction_pairs 'flor'"):
        two_boxes(PairFriction(between=("flor", "box"), friction=0.9))
    with pytest.raises(FieldError, match="friction"):
        PairFriction(between=("floor", "box"), friction=-0.1)


def test_a_report_tells_normals_and_bodies_of_each_contact() -> None:
    sim = Simulation(two_boxes())
    sim.step()
    report = sim.contacts  # normals point from the boxes to the floor
    assert len(report.points) == 8
    np.testing.assert_allclose(report.normals, [[0.0, 0.0, -1.0]] * 8, atol=1e-9)
    assert report.body_names == ("floor", "box", "other")
    assert {tuple(pair) for pair in report.bodies.tolist()} == {(0, 1), (0, 2)}
    assert all(len(each) == 8 for each in (report.forces, report.gaps, report.pairs))


def test_what_runs_away_is_refused_before_anything_is_looked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    sim = Simulation(two_boxes())
    sim.step()
    before = sim.snapshot()
    sim._state.rigid_velocities[0, :3] = 1e6
    with monkeypatch.context() as patch:
        for search in ("_sweep", "_free_share"):
            patch.setattr(sim._contacts._detector, search, lambda *_: pytest.fail("close pairs were sought"))
        with pytest.raises(SolverDivergedError):
            sim.step()
    sim.restore(before)
    sim.step()


def test_more_close_pairs_than_are_ever_listed_end_the_step(monkeypatch: pytest.MonkeyPatch) -> None:
    sim = Simulation(two_boxes())
    monkeypatch.setattr(detector, "_INITIAL_PAIRS", 1)
    monkeypatch.setattr(detector, "_MOST_PAIRS", 2)
    sim._contacts._detector._near = detector.allocate_near(1)
    sim._contacts._detector._found = detector.allocate_found(1)
    with pytest.raises(SolverDivergedError):
        sim.step()
