"""Random things that touch: nothing passes, gaps hold, and what rests weighs what it should."""

from __future__ import annotations

import math

import numpy as np
import pytest
from contact_scenes import touching
from random_contacts import KINDS, Count, hold

from softsim_core import Simulation
from softsim_core.base import Placement
from softsim_core.physics.contact import linearised
from softsim_core.physics.mesh import Shape
from softsim_core.scene import JointDescription, RigidBodyDescription


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seeds", [1, pytest.param(20, marks=pytest.mark.exhaustive)])
def test_random_scenes_hold_the_contact_law(kind: str, seeds: int) -> None:
    count = Count()
    for seed in range(seeds):
        hold(kind, seed, count)
    assert count.looks > 0


@pytest.mark.parametrize("seed", [35, 39, 47])
def test_steps_whose_contacts_alternate_are_cut(seed: int) -> None:
    count = Count()
    hold("drop", seed, count)
    assert count.deepest < 0.5e-3


def test_a_body_that_is_squeezed_beyond_its_width_does_not_cut_every_step() -> None:
    jaws = [
        RigidBodyDescription(
            name=f"jaw {side:+d}",
            shape=Shape(box=(0.01, 0.04, 0.04)),
            on="world" if side > 0 else "slide",
            pose=Placement(translation=(0.0165 * side, 0.0, 0.0)),
        )
        for side in (1, -1)
    ]
    block = RigidBodyDescription(name="block", shape=Shape(box=(0.02, 0.02, 0.02)), mass=0.05)
    slide = JointDescription(name="slide", kind="prismatic", axis=(1.0, 0.0, 0.0))
    sim = Simulation(touching(*jaws, block, joints=(slide,), gravity=(0.0, 0.0, 0.0)))
    parts = []
    for step in range(60):
        sim.command([1e-4 * min(step, 40)])
        sim.step()
        parts.append(sim.report.parts)
    assert sim.contacts.gaps.min() < -1e-3
    assert parts[-20:] == [1] * 20


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
