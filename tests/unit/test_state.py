"""State is one buffer with named views, and what is written to it stays in the buffer."""

from __future__ import annotations

import numpy as np
import pytest

from softsim_core.base import ArrayError
from softsim_core.physics.mechanics import State


def test_views_share_the_buffer() -> None:
    state = State(nodes=3, frames=2, joints=4)
    assert len(state.buffer) == 9 + 9 + 6 + 18 + 16 + 4 + 4 + 12 + 1
    state.positions[2, 2] = 5.0
    state.base_shift[0] = 7.0
    assert sorted(state.buffer.tolist())[-2:] == [5.0, 7.0]
    other = State(3, 2, 4)
    other.copy_from(state)
    assert other.positions[2, 2] == 5.0
    other.positions[2, 2] = 6.0
    assert state.positions[2, 2] == 5.0


def test_a_state_without_anything() -> None:
    assert State(0, 0, 0).buffer.tolist() == [0.0]


def test_assigning_copies_into_the_buffer() -> None:
    state = State(2, 0, 1)
    state.positions = np.ones((2, 3), dtype=np.float32, order="F")  # type: ignore[assignment]
    state.joint_positions += 2.0
    assert state.buffer.sum() == 8.0
    assert state.positions.dtype == np.float64
    with pytest.raises(ValueError, match="broadcast"):
        state.positions = np.ones((3, 3))
    with pytest.raises(ArrayError, match="warm_start"):
        state.warm_start = np.ones((2, 3))


def test_named_arrays_come_back_whatever_a_scene_keeps_beside() -> None:
    rng = np.random.default_rng(0)
    state = State(3, 1, 2, rigid=1, extra={"history": (4, 2), "none": (0,)})
    state.buffer[:] = rng.normal(size=len(state.buffer))
    state.warm_start = rng.normal(size=(5, 4))
    named = state.arrays()
    assert sum(array.size for array in named.values()) == len(state.buffer) + 20
    assert named["extra.history"].shape == (4, 2)
    other = State(3, 1, 2, rigid=1, extra={"history": (4, 2), "none": (0,)})
    other.take(named)
    np.testing.assert_array_equal(other.buffer, state.buffer)
    np.testing.assert_array_equal(other.warm_start, state.warm_start)
    np.testing.assert_array_equal(other.extra["history"], state.extra["history"])
