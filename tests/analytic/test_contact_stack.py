"""Stacks at rest: normal forces add up to the weight, nothing sinks in."""

from __future__ import annotations

import numpy as np
import pytest
from contact_scenes import DISTANCE, FLOOR, GRAVITY, force_on, loose, run, touching
from small_scenes import body

from softsim_core import Simulation
from softsim_core.physics.mesh import Shape, box_mesh

BOX = Shape(box=(0.04, 0.04, 0.04))
MASSES = (0.03, 0.05, 0.02)


def test_each_box_of_a_stack_bears_what_lies_on_it(backend: str) -> None:
    names = ("floor", "low", "middle", "high")
    boxes = [
        loose(name, BOX, 0.022 + k * 0.042, mass=mass)
        for k, (name, mass) in enumerate(zip(names[1:], MASSES, strict=True))
    ]
    sim = Simulation(touching(FLOOR, *boxes, backend=backend))
    run(sim, 150)
    for k in range(3):
        force = force_on(sim, names[k + 1], names[k])
        weight = sum(MASSES[k:]) * GRAVITY
        assert force[2] == pytest.approx(weight, rel=1e-3)
        assert np.abs(force[:2]).max() < 1e-3 * weight
        above = sim.rigid_poses[k + 1].position[2] - (sim.rigid_poses[k].position[2] if k else -0.02)
        assert above == pytest.approx(0.04 + DISTANCE, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_a_soft_block_and_a_box_on_it_rest_on_the_floor(friction: float) -> None:
    mesh = box_mesh((0.04, 0.04, 0.02), (4, 4, 2), (-0.02, -0.02, 2.0 * DISTANCE))
    soft = body(mesh, "soft", young_modulus=5e4, total_mass=0.04)
    box = loose("box", Shape(box=(0.03, 0.03, 0.03)), 0.022 + 2.0 * DISTANCE + 0.015)
    scene = touching(FLOOR, box, soft=(soft,), friction=friction, rayleigh_stiffness=0.02)
    sim = Simulation(scene)
    for _ in range(200):  # without friction the box slides off later: nothing holds it in the middle
        run(sim, 1)
        assert sim.positions[:, 2].min() > 0.0  # never deeper than the contact distance
    assert force_on(sim, "box", "soft")[2] == pytest.approx(0.03 * GRAVITY, rel=1e-3)
    assert force_on(sim, "soft", "floor")[2] == pytest.approx(0.07 * GRAVITY, rel=1e-3)
