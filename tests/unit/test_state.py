"""State is one buffer with views; its bytes come back as they went."""

from __future__ import annotations

import numpy as np
import pytest

from softsim_core.errors import SnapshotError
from softsim_core.mechanics.state import State, pack, unpack

HEADER = b"header"


def test_views_share_the_buffer() -> None:
    state = State(nodes=3, frames=2, joints=4)
    assert len(state.buffer) == 9 + 9 + 6 + 18 + 16 + 4 + 4 + 1
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


def test_what_is_packed_comes_back() -> None:
    rng = np.random.default_rng(0)
    arrays = [rng.normal(size=(4, 3)), np.zeros((0, 2)), rng.normal(size=5)]
    data = pack(HEADER, arrays)
    for back, array in zip(unpack(data, HEADER, [array.shape for array in arrays]), arrays, strict=True):
        np.testing.assert_array_equal(back, array)
        back += 1.0  # writable
    assert pack(HEADER, arrays) == data


@pytest.mark.parametrize(
    "data", [b"", b"header", b"x" * 46, pack(b"HEADER", [np.zeros(5)]), pack(HEADER, [np.zeros(6)]) + b"x"]
)
def test_foreign_bytes_are_refused(data: bytes) -> None:
    with pytest.raises(SnapshotError, match="not a snapshot of this scene"):
        unpack(data, HEADER, [(5,)])


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_values_that_are_not_finite_are_refused(value: float) -> None:
    with pytest.raises(SnapshotError, match="not finite"):
        unpack(pack(HEADER, [np.array([0.0, value])]), HEADER, [(2,)])
