"""The notch walls of the gripper's own fingers: they touch at full pull and beyond, and do not cross."""

from __future__ import annotations

import numpy as np
import pytest

from softsim_core import Simulation, load_scene


@pytest.mark.slow
def test_notch_walls_of_three_fingers_touch_and_do_not_cross() -> None:
    scene = load_scene("cable_gripper", kind="robots")
    walls = tuple(each for each in scene.scene.collisions if "walls" in each.name)
    sim = Simulation(scene.with_scene(rigid_bodies=(), collisions=walls))
    sim.enforce_limits = False  # at the limit of 35 mm they are 2 mm apart
    touched, passes = np.zeros(0), []
    for k in range(250):
        sim.command([0.07 * min(1.0, (k + 1) / 200)] * 3 + [0.0, 0.0])
        sim.step()
        assert sim.contacts.residual < 1e-6
        assert sim.contacts.gaps.min(initial=0.0) > -1e-6
        passes.append(sim.contacts.passes)
        near = sim._contacts.near(sim.collision_points, sim.contact_limits.alarm_distance)
        assert near.distance.min(initial=1.0) > 0.5 * sim.contact_limits.contact_distance
        touched = np.union1d(touched, sim.contacts.pairs[sim.contacts.forces.any(axis=1)])
    assert len(touched) == 6  # both walls of every finger
    assert max(passes) <= 4
    assert np.mean(passes) < 1.1
