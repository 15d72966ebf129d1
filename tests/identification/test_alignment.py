"""Frame and sensor point: the truth is found, its error told rightly, and what cannot be told is said."""

from __future__ import annotations

import numpy as np
import pytest

from softsim_core import rotation_exp
from softsim_core.base import Array, DataError
from softsim_core.lab.identification import align, rigid_frame

TURN, SHIFT = rotation_exp(np.array([0.4, -1.1, 0.3])), np.array([0.3, -0.2, 0.9])
POINTS = np.array([[0.004, -0.002, 0.011], [0.0, 0.02, -0.005]])


def poses(seed: int, tilt: float = 0.3, count: int = 60, sensors: int = 2) -> tuple[Array, Array]:
    """Positions (k, s, 3) and rotations (k, s, 3, 3) of something that moves 40 mm and tilts."""
    random = np.random.default_rng(seed)
    positions = np.repeat(random.uniform(-0.04, 0.04, (count, 1, 3)), sensors, axis=1)
    turns = np.array([rotation_exp(tilt * random.normal(size=3)) for _ in range(count)])
    return positions, np.repeat(turns[:, None], sensors, axis=1)


def seen(positions: Array, rotations: Array, points: Array, noise: float, seed: int) -> Array:
    """What sensors at points tell in a frame of their own."""
    truth = positions + np.einsum("ksij,sj->ksi", rotations, points)
    truth = truth + np.random.default_rng(seed + 1000).normal(0.0, noise, truth.shape)
    return np.asarray((truth - SHIFT) @ TURN)  # R m + t is the truth


@pytest.mark.parametrize("seed", range(5))
def test_the_frame_of_exact_points_is_exact(seed: int) -> None:
    (positions, _), flat = poses(seed), slice(None)
    measured = (positions[flat, 0] - SHIFT) @ TURN
    rotation, shift = rigid_frame(positions[:, 0], measured, "it")
    assert np.abs(rotation - TURN).max() < 1e-12
    assert np.abs(shift - SHIFT).max() < 1e-12


@pytest.mark.parametrize("seed", range(5))
def test_frame_and_points_are_found_together(seed: int) -> None:
    positions, rotations = poses(seed)
    found = align(
        positions,
        rotations,
        seen(positions, rotations, POINTS, 0.0, seed),
        np.zeros((2, 3)),
        (True, True),
        "it",
    )
    assert np.abs(found.rotation - TURN).max() < 1e-9
    assert np.abs(found.points - POINTS).max() < 1e-9
    assert np.abs(found.shift - SHIFT).max() < 1e-9


def test_the_standard_error_of_the_point_is_that_of_many_measurements() -> None:
    away, told = [], []
    for seed in range(120):
        positions, rotations = poses(7)
        measured = seen(positions, rotations, POINTS, 5e-4, seed)
        found = align(positions, rotations, measured, np.zeros((2, 3)), (True, True), "it")
        away.append(found.points - POINTS)
        told.append(found.point_errors)
    assert np.std(away, axis=0) == pytest.approx(np.mean(told, axis=0), rel=0.25)


def test_no_smaller_error_is_near_what_is_found() -> None:
    positions, rotations = poses(2)
    measured = seen(positions, rotations, POINTS, 1e-3, 2)
    found = align(positions, rotations, measured, np.zeros((2, 3)), (True, True), "it")

    def misfit(turn: Array, shift: Array, points: Array) -> float:
        sensed = positions + np.einsum("ksij,sj->ksi", rotations, found.points + points)
        frame = rotation_exp(turn) @ found.rotation
        return float(((sensed - measured @ frame.T - found.shift - shift) ** 2).sum())

    least, zero = misfit(np.zeros(3), np.zeros(3), np.zeros((2, 3))), np.zeros(3)
    for axis in np.vstack([np.eye(3), -np.eye(3)]):
        assert misfit(1e-4 * axis, zero, np.zeros((2, 3))) > least
        assert misfit(zero, 1e-5 * axis, np.zeros((2, 3))) > least
        assert misfit(zero, zero, 1e-5 * np.outer([1.0, 0.0], axis)) > least


def test_a_point_alone_is_found_where_the_frame_is_known() -> None:
    positions, rotations = poses(1, sensors=1)
    measured = positions + np.einsum("ksij,sj->ksi", rotations, POINTS[:1])
    found = align(positions, rotations, measured, np.zeros((1, 3)), (False, True), "it")
    assert np.abs(found.points - POINTS[:1]).max() < 1e-12
    assert np.array_equal(found.rotation, np.eye(3))


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ("line", "it: the measured points lie on a line, about which a frame is free to turn"),
        ("two", "it: 2 rows cannot determine a frame; measure 3 or more"),
        ("three", "it: 3 rows cannot determine the 9 numbers of frame and sensor points"),
        (
            "level",
            "it: the rows do not tell frame and sensor point apart: what the sensor sits on hardly tilts",
        ),
        (
            "mirror",
            "it: a mirrored frame fits better, 0.00 mm against .* are swapped",
        ),
    ],
)
def test_what_the_rows_do_not_tell_is_said(change: str, sentence: str) -> None:
    positions, rotations = poses(0, tilt=0.0 if change == "level" else 0.3, sensors=1)
    if change == "line":
        positions = positions * (1.0, 0.0, 0.0)
        rotations = np.tile(np.eye(3), (len(positions), 1, 1, 1))
    count = {"two": 2, "three": 3}.get(change, len(positions))
    measured = seen(positions, rotations, 0.0 * POINTS[:1], 0.0, 0)
    if change == "mirror":
        measured = measured[..., [1, 0, 2]]
    with pytest.raises(DataError, match=sentence):
        align(
            positions[:count],
            rotations[:count],
            measured[:count],
            np.zeros((1, 3)),
            (True, True),
            "it",
        )


def test_points_in_a_plane_have_a_frame() -> None:
    positions, _ = poses(4, sensors=1)
    flat = positions[:, 0] * (1.0, 1.0, 0.0)
    rotation, _ = rigid_frame(flat, (flat - SHIFT) @ TURN, "it")
    assert np.abs(rotation - TURN).max() < 1e-9
