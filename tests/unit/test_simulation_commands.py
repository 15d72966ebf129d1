"""Simulation: commands, limits and the start animation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_scenes import limited, machine

from softsim_core import Simulation, load_scene
from softsim_core.base import (
    Backend,
    CommandError,
    SceneError,
)

A = -1.4965
DT = 0.01


def test_a_command_is_clamped_and_returned(backend: Backend) -> None:
    sim = Simulation(limited(), backend=backend)
    for wanted, accepted in ((0.2, 0.2), (3.0, 0.5), (-7.0, -1.0)):
        assert sim.command([wanted]).tolist() == [accepted]
        assert sim.joint_targets.tolist() == [accepted]
        sim.step()
        assert sim.joint_positions.tolist() == [accepted]


def test_a_scene_may_refuse_instead() -> None:
    sim = Simulation(limited("refuse"), backend="scipy")
    sim.command([0.3])
    with pytest.raises(CommandError, match=r"command 0.6 for joint hinge refused: allowed is \[-1.0, 0.5\]"):
        sim.command([0.6])
    assert sim.joint_targets.tolist() == [0.3]


@pytest.mark.parametrize(
    ("value", "limit"), [(0.1 + 0.4 + 1e-16, 0.5), (float(np.float32(-1.0000001)), -1.0)]
)
def test_round_off_beyond_a_limit_is_at_the_limit(value: float, limit: float) -> None:
    sim = Simulation(limited("refuse"), backend="scipy")
    assert sim.command([value]).tolist() == [limit]
    with pytest.raises(CommandError, match="refused: allowed is"):
        sim.command([limit * 1.00001])


def test_without_limits_full_turns_are_allowed(backend: Backend) -> None:
    sim = Simulation(limited(speed=1.0), backend=backend)
    sim.enforce_limits = False
    assert sim.command([7.0]).tolist() == [7.0]
    sim.step()
    assert sim.joint_positions.tolist() == [7.0]  # the speed limit is off too


@pytest.mark.parametrize("values", [[], [0.1, 0.2], [np.nan], [np.inf]])
def test_a_wrong_command_changes_nothing(values: list[float]) -> None:
    sim = Simulation(limited(), backend="scipy")
    sim.command([0.3])
    before = sim.snapshot()
    with pytest.raises(CommandError, match="nothing was moved"):
        sim.command(values)
    assert sim.snapshot() == before
    sim.step()
    assert sim.joint_positions.tolist() == [0.3]


@pytest.mark.parametrize("shift", [np.nan, np.inf])
def test_a_base_shift_is_finite(shift: float) -> None:
    sim = Simulation(limited(), backend="scipy")
    with pytest.raises(CommandError, match="base_shift"):
        sim.base_shift = shift


def test_joints_keep_their_speed_limit(backend: Backend) -> None:
    sim = Simulation(limited(speed=2.0), backend=backend)
    sim.command([0.05])
    reached = []
    for _ in range(5):
        sim.step()
        reached.append(float(sim.joint_positions[0]))
    assert reached == pytest.approx([0.02, 0.04, 0.05, 0.05, 0.05], abs=1e-15)
    sim.command([-1.0])
    for _ in range(200):
        before = sim.joint_positions[0]
        sim.step()
        assert abs(sim.joint_positions[0] - before) <= 2.0 * DT + 1e-12
    assert sim.joint_positions[0] == -1.0


def test_start_animation_of_the_tripod_takes_21_steps(backend: Backend) -> None:
    """Factors 0, 0.05 .. 1, absolute, not slowed by the speed limit; then the pose is held."""
    sim = Simulation(load_scene("tripod"), backend=backend)
    for _ in range(2):  # pressing again starts again from the rest pose
        sim.start_animation()
        for i in range(21):
            sim.step()
            assert sim.joint_positions == pytest.approx(np.full(3, A * i / 20), abs=1e-12)
            assert sim.base_shift == pytest.approx(0.035 * i / 20, abs=1e-12)
            assert sim.joint_targets == pytest.approx(sim.joint_positions)
    for _ in range(3):
        sim.step()
        assert sim.joint_positions == pytest.approx(np.full(3, A))
        assert sim.base_shift == pytest.approx(0.035)


def test_a_command_takes_the_joints_from_the_animation_and_the_bases_still_arrive() -> None:
    sim = Simulation(limited(), backend="scipy")
    sim.start_animation()
    for _ in range(3):
        sim.step()
    sim.command([-0.2])
    for _ in range(3):
        sim.step()
    assert sim.joint_positions.tolist() == [-0.2]
    assert sim.base_shift == pytest.approx(0.02)


def test_a_scene_may_play_it_at_once_and_again_after_a_reset() -> None:
    description = limited()
    assert description.start is not None
    sim = Simulation(replace(description, start=replace(description.start, at_start=True)), backend="scipy")
    for _ in range(2):
        for _ in range(6):
            sim.step()
        assert sim.joint_positions == pytest.approx([0.4])
        sim.reset()


def test_a_scene_without_animation_says_so() -> None:
    with pytest.raises(SceneError, match="has no start animation"):
        Simulation(machine(), backend="scipy").start_animation()
