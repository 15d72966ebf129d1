"""Experiments of cosseratbench that cost little: our rods against the suite's own references."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cosseratbench", reason="cosseratbench is not installed: pip install 'softsim[peers]'")

from cosseratbench import (
    EndCondition,
    Material,
    Motion,
    Plane,
    Rod,
    Scenario,
    registry,
    run,
)

from benchmarks import cosserat

STIFF = Material(youngs_modulus=1e6, shear_modulus=1e6 / 3.0, density=1000.0)


def outcome(name: str, **options: Any) -> dict[str, float]:
    result = run(registry.load_experiment(name), cosserat.RodSolver(), **options)
    assert result.outcome == "completed", result.failure
    return {**result.metrics, **result.observations}


def upright(**fields: Any) -> Rod:
    return Rod(
        centerline=((0.0, 0.0, 0.4), (0.0, 0.0, 0.0)),
        radius=0.01,
        material=STIFF,
        normal=(0.0, 1.0, 0.0),
        **fields,
    )


def test_a_small_load_bends_a_clamped_rod_as_euler_and_bernoulli_say() -> None:
    """The suite's reference neglects shear and large rotations, each less than 0.1 %."""
    assert outcome("cantilever")["tip_deflection_error"] < 1e-3


def test_a_pinned_rod_hangs_in_the_catenary() -> None:
    """The reference neglects bending, which lifts the rod by a part of 5e-4 of its length."""
    assert outcome("catenary")["shape_error"] < 6e-4


@pytest.mark.slow
@pytest.mark.numba
def test_a_hanging_rod_swings_with_its_first_frequency() -> None:
    """At this amplitude the period is longer by 2e-5 than that of small swings."""
    found = outcome("pendulum", n_elements=20)
    assert found["period_error"] < 1e-4
    assert abs(found["amplitude_change"]) < 1e-3


@pytest.mark.slow
@pytest.mark.numba
def test_an_end_follows_its_motion_and_carries_the_rod_with_it() -> None:
    """The rod's other end is free; the motion shifts the end by 50 mm and turns it by half a radian."""
    motion = Motion(
        times=(0.0, 0.1), displacement=((0.0,) * 3, (0.0, 0.0, 0.05)), rotation=((0.0,) * 3, (0.0, 0.0, 0.5))
    )
    rod = upright(start=EndCondition.CLAMPED, start_motion=motion)
    moved = cosserat.RodSolver().run(
        Scenario(rods=(rod,), duration=0.2, self_contact=False), n_elements=8, n_frames=5
    )
    start = moved.positions[0][:, 0]
    np.testing.assert_allclose(start[[0, 2, 4], 2], [0.4, 0.45, 0.45], atol=1e-9)
    first, last = moved.directors[0][[0, -1], 0]
    assert math.acos(float(first @ last)) == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize(
    ("fields", "scenario"),
    [
        (
            {
                "start": EndCondition.CLAMPED,
                "start_motion": Motion(
                    times=(0.0, 0.1, 0.2),
                    displacement=((0.0,) * 3,) * 3,
                    rotation=((0.0,) * 3, (0.1, 0.0, 0.0), (0.1, 0.1, 0.0)),
                ),
            },
            {"self_contact": False},
        ),
        ({}, {"obstacles": (Plane(point=(0.0, 0.0, -1.0), normal=(0.6, 0.0, 0.8)),)}),
    ],
)
def test_what_a_scene_cannot_express_is_refused(fields: dict[str, Any], scenario: dict[str, Any]) -> None:
    with pytest.raises(NotImplementedError):
        cosserat.RodSolver().run(
            Scenario(rods=(upright(**fields),), duration=0.1, **scenario), n_elements=4, n_frames=2
        )


def test_places_follow_the_measure_and_times_are_relative_to_ours() -> None:
    def scored(solver: str, value: float, seconds: float) -> cosserat.Score:
        result = SimpleNamespace(
            experiment="cantilever", solver=solver, supported=True, observations={}, outcome="completed",
            metrics={"tip_deflection_error": value},
        )  # fmt: skip
        return cosserat.Score(result, seconds)  # type: ignore[arg-type]

    scores = [scored(cosserat.OURS, 0.2, 2.0), scored("other", 0.1, 6.0), scored("broken", math.nan, 1.0)]
    cosserat.set_places(scores)
    assert [each.place for each in scores] == [2, 1, None]
    assert [each.ratio for each in scores] == [1.0, 3.0, 0.5]
    assert len(cosserat.score_table(scores)) == 4
