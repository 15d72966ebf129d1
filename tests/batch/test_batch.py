"""Copies of a scene give the bytes of single runs: contacts, cables, chambers, parameters, any workers."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softsim_core import Batch, BatchError, CommandError, Controller, Simulation, load_scene

FOLDER = Path(__file__).parent
PATHS = os.pathsep.join([str(FOLDER.parents[1]), *filter(None, sys.path)])
sys.path.append(str(FOLDER))

from compared_runs import COPIES, commands, same_bytes  # noqa: E402 (found by the line above)


@pytest.mark.slow
@pytest.mark.numba
@pytest.mark.parametrize("name", ["tripod_ball", "cable_gripper", "pneu_finger"])
def test_copies_give_the_bytes_of_single_runs(name: str) -> None:
    assert same_bytes(name, 1)


@pytest.mark.slow
@pytest.mark.numba
def test_copies_of_two_workers_give_the_bytes_of_single_runs() -> None:
    """Of one scene; the exhaustive test takes all."""
    # processes that load compiled kernels are compared, not the one that has just compiled them
    script = [sys.executable, str(FOLDER / "compared_runs.py"), "tripod_ball", "2"]
    done = subprocess.run(script, env={**os.environ, "PYTHONPATH": PATHS}, timeout=300, check=False)
    assert done.returncode == 0


@pytest.mark.numba
@pytest.mark.exhaustive
@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("name", ["tripod_ball", "cable_gripper", "pneu_finger"])
def test_copies_give_the_bytes_of_single_runs_over_1000_steps(name: str, workers: int) -> None:
    assert same_bytes(name, workers, 167)


@pytest.mark.numba
def test_a_reset_leaves_no_trace_and_touches_no_other_copy() -> None:
    robot = load_scene("tripod_ball")
    told = commands(robot, "tripod_ball", 2, 4)
    fresh = Simulation(robot)
    with Batch(robot, COPIES) as batch:
        begun = batch.call(1, "snapshot")
        for rows in told:
            batch.command(rows)
            batch.step(10)
        others = [batch.call(k, "snapshot") for k in (0, 2)]
        batch.reset([1])
        assert batch.call(1, "snapshot") == begun == fresh.snapshot()
        assert [batch.call(k, "snapshot") for k in (0, 2)] == others
        for rows in told:
            batch.command(rows[1:2], [1])
            batch.step(10, [1])
            fresh.command(rows[1])
            for _ in range(10):
                fresh.step()
        assert batch.call(1, "snapshot") == fresh.snapshot()
        assert [batch.call(k, "snapshot") for k in (0, 2)] == others


@pytest.mark.slow
@pytest.mark.numba
def test_a_copy_may_have_another_mass_and_friction() -> None:
    robot = load_scene("tripod_ball")
    body, ball = robot.scene.bodies[0], robot.scene.rigid_bodies[0]
    other = load_scene(
        "tripod_ball",
        {
            "bodies": [{"name": body.name, "total_mass": 0.040}],
            "rigid_bodies": [{"name": ball.name, "mass": 0.010}],
            "contact": {"friction": 0.5},
        },
    )
    single = Simulation(other)
    told = commands(robot, "tripod_ball", 3, 4)
    with Batch(robot, 2) as batch:
        for number in (1, 0):
            batch.rebuild(number, other)
            single.reset()
            for rows in told:
                batch.command(rows[:2])
                batch.step(10)
                single.command(rows[number])
                for _ in range(10):
                    single.step()
            assert batch.call(number, "snapshot") == single.snapshot()
            batch.reset()
        with pytest.raises(BatchError, match="numbers"):
            batch.rebuild(0, load_scene("tripod"))


@pytest.mark.numba
def test_what_has_diverged_stands_still_until_it_is_reset() -> None:
    robot = load_scene("tripod")
    with Batch(robot, COPIES) as batch:
        batch.step(3)
        batch.call(1, "set_velocities", np.full(batch.array("velocities")[1].shape, 1e9))
        before = batch.array("positions")[1].copy()
        assert batch.step(5) == [1]
        assert "diverged" in batch.failed[1]
        assert np.array_equal(batch.array("positions")[1], before)
        assert batch.step(5) == []
        batch.reset([1])
        assert batch.failed == {}
        assert batch.step(5) == []


def test_wrong_numbers_are_refused() -> None:
    robot = load_scene("tripod")
    with pytest.raises(BatchError, match="at least 1"):
        Batch(robot, 0)
    batch = Batch(robot, 2, backend="scipy")
    with pytest.raises(BatchError, match="numbered 0 to 1"):
        batch.reset([2])
    with pytest.raises(CommandError, match="finite"):
        batch.command(np.full((2, 3), np.nan))
    with pytest.raises(BatchError, match="positions"):
        batch.array("places")


@pytest.mark.slow
@pytest.mark.numba
def test_a_worker_that_ends_is_told_in_one_sentence() -> None:
    with Batch(load_scene("tripod"), 2, workers=2) as batch:
        os.kill(batch._remote[0]._process.pid, signal.SIGKILL)
        batch._remote[0]._process.wait()
        with pytest.raises(BatchError, match="worker process of the batch has ended"):
            batch.step()


@pytest.mark.slow
@pytest.mark.numba
@pytest.mark.parametrize("resets", [300, pytest.param(100_000, marks=pytest.mark.exhaustive)])
def test_memory_does_not_grow_over_resets(resets: int) -> None:
    script = [sys.executable, str(FOLDER / "traced_resets.py"), str(resets)]  # nothing else runs in it
    environment = {**os.environ, "PYTHONPATH": PATHS}
    done = subprocess.run(script, env=environment, stdout=subprocess.PIPE, timeout=3000, check=True)
    held = json.loads(done.stdout)
    # a leak grows each time; what NumPy still keeps grows less and less
    assert np.diff(held).min() < 4_000, held


@pytest.mark.slow
def test_a_scene_that_cannot_be_handed_over_is_refused() -> None:
    robot = replace(load_scene("tripod"), controllers=(Controller(on_begin=lambda simulation: None),))
    with pytest.raises(BatchError, match="workers=1"):
        Batch(robot, 2, workers=2)
