"""Random things that touch: nothing passes, gaps hold, and what rests weighs what it should."""

from __future__ import annotations

import math

import numpy as np
import pytest
from random_contacts import KINDS, Count, hold

from softsim_core import Simulation
from softsim_core.physics.contact import linearised


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seeds", [1, pytest.param(20, marks=pytest.mark.exhaustive)])
def test_random_scenes_hold_the_contact_law(kind: str, seeds: int) -> None:
    count = Count()
    for seed in range(seeds):
        hold(kind, seed, count)
    assert count.looks > 0


@pytest.mark.parametrize("kind", ["stack", "fold"])
@pytest.mark.parametrize("foreseen", [-math.inf, math.inf], ids=["none", "all"])
def test_the_solution_does_not_depend_on_which_contacts_are_foreseen(
    kind: str, foreseen: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = KINDS[kind](np.random.default_rng(3))
    usual = Simulation(scene)
    for _ in range(8):
        usual.step()
    assert usual.contacts.forces.any()
    monkeypatch.setattr(linearised, "_FORESEEN", foreseen)
    other = Simulation(scene)
    for _ in range(usual.step_count):
        other.step()
    assert np.abs(other.collision_points - usual.collision_points).max() < 5e-6
    assert other.contacts.residual <= usual.contact_limits.tolerance
