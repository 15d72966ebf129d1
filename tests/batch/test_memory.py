"""What a copy was before it was rebuilt is freed at once: it holds a whole plan; no collection is awaited."""

from __future__ import annotations

import gc

import pytest

pytest.importorskip("numba")

from softsim_core.physics.dynamics.numba_backend import NumbaStepper
from softsim_core.scene import load_scene
from softsim_core.simulation.batch import Batch


def steppers() -> int:
    return sum(type(each) is NumbaStepper for each in gc.get_objects())


@pytest.mark.slow
def test_rebuilt_copies_leave_no_stepper_behind() -> None:
    robot = load_scene("tripod")
    batch = Batch(robot, 1)
    batch.step()
    gc.collect()
    gc.disable()
    try:
        batch.rebuild(0, robot)  # the first one goes on planning for all
        before = steppers()
        for _ in range(5):
            batch.rebuild(0, robot)
            batch.step()
        assert steppers() == before
    finally:
        gc.enable()
