"""A soft block on another soft block: contact of two deformable bodies whose meshes do not match."""

from __future__ import annotations

import numpy as np
import pytest
from contact_scenes import FLOOR, GRAVITY, force_on, run, touching
from small_scenes import body

from softsim_core import Simulation
from softsim_core.physics.mesh import box_mesh

LOW_MASS, HIGH_MASS = 0.05, 0.03
GAP = 0.002
"""Of each block to what is below it at the start, in [m]: it falls by 1 mm."""


@pytest.mark.slow
def test_a_soft_block_rests_on_a_softer_one() -> None:
    low = box_mesh((0.05, 0.05, 0.02), (4, 4, 2), (-0.025, -0.025, GAP))
    high = box_mesh((0.03, 0.03, 0.02), (3, 3, 2), (-0.013, -0.016, 2.0 * GAP + 0.02))
    blocks = (
        body(low, "low", young_modulus=3e4, total_mass=LOW_MASS),
        body(high, "high", young_modulus=8e4, total_mass=HIGH_MASS),
    )
    sim = Simulation(touching(FLOOR, soft=blocks, rayleigh_stiffness=0.02))
    lower = slice(0, len(low.points))
    for _ in range(200):
        run(sim, 1)
        assert sim.positions[:, 2].min() > 0.0
    np.testing.assert_allclose(force_on(sim, "high", "low"), [0.0, 0.0, HIGH_MASS * GRAVITY], atol=1e-3)
    np.testing.assert_allclose(force_on(sim, "low", "high"), -force_on(sim, "high", "low"), rtol=1e-12)
    assert force_on(sim, "low", "floor")[2] == pytest.approx((LOW_MASS + HIGH_MASS) * GRAVITY, rel=2e-3)
    under = sim.positions[lower, 2].max()
    above = sim.positions[len(low.points) :, 2].min()
    assert above - under > -5e-4  # the dent is bent, but nothing has sunk in
