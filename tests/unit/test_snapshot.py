"""Named arrays come back from bytes as they went; nothing foreign or damaged comes in."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

from softsim_core.base import Array, SnapshotError
from softsim_core.physics.mechanics import MAGIC, pack, unpack

SCENE = bytes(range(32))


def some() -> dict[str, Array]:
    rng = np.random.default_rng(0)
    return {"a": rng.normal(size=(4, 3)), "empty": np.zeros((0, 2)), "b": rng.normal(size=5)}


def shapes(arrays: dict[str, Array]) -> dict[str, tuple[int, ...]]:
    return {name: array.shape for name, array in arrays.items()}


def test_what_is_packed_comes_back() -> None:
    arrays = some()
    data = pack(SCENE, arrays)
    back = unpack(data, SCENE, shapes(arrays))
    assert list(back) == list(arrays)
    for name, array in arrays.items():
        np.testing.assert_array_equal(back[name], array)
        back[name] += 1.0  # writable
    assert pack(SCENE, arrays) == data
    assert unpack(data, SCENE, {**shapes(arrays), "a": (-1, 3)})["a"].shape == (4, 3)


def test_every_flipped_byte_and_every_cut_is_noticed() -> None:
    arrays = some()
    data = pack(SCENE, arrays)
    for place in range(len(data)):
        broken = bytearray(data)
        broken[place] ^= 0x10
        with pytest.raises(SnapshotError):
            unpack(bytes(broken), SCENE, shapes(arrays))
        with pytest.raises(SnapshotError):
            unpack(data[:place], SCENE, shapes(arrays))
    with pytest.raises(SnapshotError, match="damaged or cut short"):
        unpack(data + b"x", SCENE, shapes(arrays))


def test_another_format_or_scene_is_refused_in_a_sentence() -> None:
    arrays = some()
    old = hashlib.sha256(b"scene").digest() + np.zeros(17).tobytes()
    for data in (b"", old):
        with pytest.raises(SnapshotError, match="an older version wrote it, or it is something else; save"):
            unpack(data, SCENE, shapes(arrays))
    with pytest.raises(SnapshotError, match="another version of the suite; save a new one"):
        unpack(pack(SCENE, arrays).replace(b"version 2", b"version 3"), SCENE, shapes(arrays))
    with pytest.raises(SnapshotError, match="not a snapshot of this scene: save a new one"):
        unpack(pack(bytes(32), arrays), SCENE, shapes(arrays))
    assert MAGIC in pack(SCENE, {})


def test_missing_and_unknown_names_and_wrong_shapes_are_named() -> None:
    arrays = some()
    wanted = shapes(arrays)
    with pytest.raises(SnapshotError, match="the snapshot lacks more, further; save a new one"):
        unpack(pack(SCENE, arrays), SCENE, {**wanted, "more": (1,), "further": (2,)})
    with pytest.raises(SnapshotError, match="the snapshot holds unknown b; save a new one"):
        unpack(pack(SCENE, arrays), SCENE, {name: wanted[name] for name in ("a", "empty")})
    with pytest.raises(SnapshotError, match=r"the snapshot's a has shape \(4, 3\), not \(3, 4\)"):
        unpack(pack(SCENE, arrays), SCENE, {**wanted, "a": (3, 4)})


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_values_that_are_not_finite_are_refused(value: float) -> None:
    arrays = {"a": np.array([0.0, value])}
    with pytest.raises(SnapshotError, match="not finite"):
        unpack(pack(SCENE, arrays), SCENE, shapes(arrays))
