"""Joint bases that are moved while the scene runs: what is attached goes along, at a hand's pace."""

from __future__ import annotations

import numpy as np
import pytest

from softsim_core import Simulation, load_scene
from softsim_core.base import CommandError

LIFT = np.array([0.0, 0.0, 0.005])


def test_both_back_ends_agree_while_a_servo_of_the_tripod_is_moved() -> None:
    sims = [Simulation(load_scene("tripod"), backend=backend) for backend in ("numba", "scipy")]
    for sim in sims:
        start = sim.positions
        sim.move_base("servo_0", sim.frames()["servo_0"].position + np.array([0.004, 0.002, 0.0]))
        for _ in range(20):
            sim.step()
        assert np.abs(sim.positions - start).max() > 0.003
    np.testing.assert_allclose(sims[0].positions, sims[1].positions, atol=1e-8)


def test_a_snapshot_holds_the_bases_and_a_reset_takes_them_back() -> None:
    sim = Simulation(load_scene("tripod"))
    start = sim.frames()["servo_1"].position
    sim.move_base("servo_1", start + LIFT)
    for _ in range(4):
        sim.step()
    half = sim.snapshot()
    for _ in range(20):
        sim.step()
    end, positions = sim.frames()["servo_1"].position, sim.positions
    np.testing.assert_array_equal(end, start + LIFT)
    sim.restore(half)
    for _ in range(20):
        sim.step()
    np.testing.assert_array_equal(sim.positions, positions)
    sim.reset()
    np.testing.assert_array_equal(sim.frames()["servo_1"].position, start)
    fresh = Simulation(load_scene("tripod"))
    for each in (sim, fresh):
        each.step()
    np.testing.assert_array_equal(sim.positions, fresh.positions)


def test_a_base_goes_where_it_is_told_also_when_the_start_move_has_shifted_it() -> None:
    sim = Simulation(load_scene("tripod"))
    sim.base_shift = 0.01
    sim.step()
    wanted = sim.frames()["servo_2"].position + LIFT
    sim.move_base("servo_2", wanted)
    for _ in range(20):
        sim.step()
    np.testing.assert_allclose(sim.frames()["servo_2"].position, wanted, atol=1e-15)


def test_a_wrong_base_is_refused_in_a_sentence() -> None:
    sim = Simulation(load_scene("cable_gripper"))
    with pytest.raises(CommandError, match="no joint 'finger_1_cable' has a base; known: vertical, sideways"):
        sim.move_base("finger_1_cable", (0.0, 0.0, 0.0))
    with pytest.raises(CommandError, match="three finite numbers"):
        sim.move_base("vertical", (0.0, 0.0, float("nan")))
    with pytest.raises(CommandError, match="three finite numbers"):
        sim.move_base("vertical", (0.0, 0.0))


def test_a_moved_base_is_state_and_the_model_stays_as_it_was_built() -> None:
    sim = Simulation(load_scene("tripod"))
    built = [joint.base_position.copy() for joint in sim.model.joints]
    sim.move_base("servo_0", sim.frames()["servo_0"].position + LIFT)
    for _ in range(30):
        sim.step()
    for joint, position in zip(sim.model.joints, built, strict=True):
        np.testing.assert_array_equal(joint.base_position, position)
    twin = sim.model.empty_state()
    twin.copy_from(sim._state)
    sim.reset()
    origin, _ = sim.model.base_frame(0, twin)
    np.testing.assert_allclose(origin, built[0] + LIFT, atol=1e-12)
