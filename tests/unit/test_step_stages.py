"""Stages of a step: their tree, the ring of the last steps, and the message that carries it."""

from __future__ import annotations

import numpy as np
import pytest

from softsim_core import Simulation, load_scene
from softsim_core.physics.dynamics import PART_OF, StageShare, stage_tree


def test_a_stage_comes_before_its_parts_and_has_what_they_leave() -> None:
    times = {
        "assemble": 2.0,
        "contact": 5.0,
        "forces": 3.0,
        "compliance": 1.5,
        "step": 8.0,
        "publishing": 1.0,
    }
    assert stage_tree(times) == [
        StageShare("step", 0, 8.0, 1.0),
        StageShare("assemble", 1, 2.0, 2.0),
        StageShare("contact", 1, 5.0, 0.5),
        StageShare("forces", 2, 3.0, 3.0),
        StageShare("compliance", 2, 1.5, 1.5),
        StageShare("publishing", 0, 1.0, 1.0),
    ]
    assert stage_tree({"forces": 1.0}) == [StageShare("forces", 0, 1.0, 1.0)]


@pytest.mark.parametrize("scene", ["tripod", "tripod_ball", "cable_finger"])
def test_the_parts_of_a_real_step_take_no_longer_than_it(scene: str) -> None:
    simulation = Simulation(load_scene(scene), backend="scipy")
    for _ in range(40):
        simulation.step()
        if len(simulation.contacts.forces) and simulation.contacts.forces.any():
            break
    times = simulation.stage_times
    assert set(times) - set(PART_OF) == {"step"}
    for whole in set(PART_OF.values()) & set(times):
        assert sum(times[part] for part in times if PART_OF.get(part) == whole) <= times[whole]
    assert (times.get("compliance", 0.0) > 0.0) == (scene == "tripod_ball")  # cables are solved with the step


def test_the_ring_keeps_the_last_steps_in_order() -> None:
    pytest.importorskip("rclpy")
    from softsim_ros.nodes.simulator import StepHistory

    history = StepHistory(4)
    assert history.steps()[1].shape == (0, 0)
    for step in range(1, 8):
        history.add(step, 0.01 * step, {"step": float(step), "publishing": 0.5})
    stages, rows = history.steps()
    assert stages == ("step", "publishing")
    np.testing.assert_allclose(rows, [[n, 0.01 * n, n, 0.5] for n in (4, 5, 6, 7)])
    history.add(1, 0.01, {"step": 9.0, "publishing": 0.5})  # after a reset
    assert history.steps()[1].tolist() == [[1.0, 0.01, 9.0, 0.5]]
    history.add(2, 0.02, {"assemble": 1.0, "step": 9.0})  # of another scene
    assert history.steps()[0] == ("assemble", "step")
    assert len(history.steps()[1]) == 1


def test_a_profile_reads_back_as_it_was_written() -> None:
    pytest.importorskip("rclpy")
    from softsim_ros.messages import read_step_profile, step_profile

    rows = np.arange(12.0).reshape(3, 4)
    stages, read = read_step_profile(step_profile(("step", "publishing"), rows))
    assert stages == ("step", "publishing")
    np.testing.assert_array_equal(read, rows)
    assert read_step_profile(step_profile((), np.zeros((0, 0))))[0] == ()
