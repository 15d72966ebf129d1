"""Bodies slide on meshes and slabs as on a plane: without friction evenly, or as Coulomb's law says."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from flat_floors import BODIES, DISTANCE, FLOORS, RIGID_FLOORS, Slide, closed_form, slide

SPEEDS = (0.01, 0.03, 0.1, 0.3, 1.0)
STEPS = (0.002, 0.01, 0.02)
FRICTIONS = (0.0, 0.3)
PLANES = (
    (0.0, (0.0, 0.0, 0.0)),
    (0.0, (0.3, -0.2, 0.5)),
    (0.1, (0.0, 0.1, 0.0)),
    (0.2, (1.0, 2.0, -0.4)),
    (0.4, (-0.7, 0.2, 3.0)),
)
"""Slopes against gravity in [rad], and rotation vectors in [rad] of the scene with its gravity."""
_DENT = 0.005
"""What the dent of a soft floor may take off or add to a speed in [m/s]."""


def check(case: Slide, folder: Path) -> None:
    """Hold a case to the closed forms."""
    speeds, ways, gaps = slide(case, folder)
    expected, reached = closed_form(case)
    assert np.abs(gaps).max() < DISTANCE, case
    if case.friction == 0.0:
        allowed = (1e-3 if case.floor in RIGID_FLOORS else 1e-2) * case.speed
        if case.floor == "soft slab":
            allowed += _DENT
        assert np.abs(speeds - expected).max() < allowed, case
    else:
        rigid = case.floor in RIGID_FLOORS and case.body != "soft block"
        dent = _DENT * case.dt * len(ways) if case.floor == "soft slab" else 0.0
        way = pytest.approx(reached[-1], rel=0.01 if rigid else 0.03, abs=(1e-7 if rigid else 3e-5) + dent)
        assert ways[-1] == way, case


def sample() -> list[Slide]:
    """Each body on each floor once, with everything else drawn from a seed."""
    random = np.random.default_rng(27)
    cases = []
    for body, floor in itertools.product(BODIES, FLOORS):
        slope, turn = PLANES[random.integers(len(PLANES))]
        speed, dt, friction = (float(random.choice(each)) for each in (SPEEDS, STEPS, FRICTIONS))
        cases.append(Slide(body, floor, speed, dt, friction, slope, turn))
    return cases


@pytest.mark.slow
@pytest.mark.parametrize("case", sample(), ids=lambda case: f"{case.body}-{case.floor}")
def test_a_sample_slides_as_on_a_plane(case: Slide, tmp_path: Path) -> None:
    check(case, tmp_path)


@pytest.mark.parametrize("floor", ["mesh", "held slab"])
@pytest.mark.parametrize("body", ["box", "ball"])
def test_both_implementations_slide_alike(body: str, floor: str, backend: str, tmp_path: Path) -> None:
    check(Slide(body, floor, 0.5, 0.01, 0.0, *PLANES[1], backend), tmp_path)
    check(Slide(body, floor, 0.5, 0.01, 0.3, *PLANES[1], backend), tmp_path)


@pytest.mark.exhaustive
@pytest.mark.parametrize("floor", FLOORS)
@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("plane", PLANES)
def test_everything_slides_as_on_a_plane(
    body: str, floor: str, plane: tuple[float, tuple[float, float, float]], tmp_path: Path
) -> None:
    for speed, dt, friction in itertools.product(SPEEDS, STEPS, FRICTIONS):
        check(Slide(body, floor, speed, dt, friction, *plane), tmp_path)
