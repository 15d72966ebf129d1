"""Rotations: exponential, logarithm, Euler angles and quaternions agree with each other."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softsim_core.physics.mechanics import (
    cross_matrix,
    euler_of,
    quaternion_of,
    rotation_euler,
    rotation_exp,
    rotation_log,
    rotation_of,
)

VECTORS = [
    np.zeros(3),
    np.array([1e-10, 0.0, 0.0]),
    np.array([0.0, 1e-7, 1e-7]),
    np.array([0.3, -0.2, 0.5]),
    np.array([np.pi - 1e-6, 0.0, 0.0]),
    np.array([0.0, np.pi, 0.0]),
    np.array([1.0, 1.0, 1.0]) * (np.pi - 1e-9) / np.sqrt(3.0),
    *np.random.default_rng(0).uniform(-1.8, 1.8, (20, 3)),
]


@pytest.mark.parametrize("vector", VECTORS)
def test_exponential_is_the_rotation_by_the_vector(vector: np.ndarray) -> None:
    rotation = rotation_exp(vector)
    np.testing.assert_allclose(rotation, Rotation.from_rotvec(vector).as_matrix(), atol=1e-14)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


@pytest.mark.parametrize("vector", VECTORS)
def test_logarithm_takes_the_exponential_back(vector: np.ndarray) -> None:
    back = rotation_log(rotation_exp(vector))
    if np.linalg.norm(vector) > np.pi - 1e-5:  # half a turn either way is the same rotation
        np.testing.assert_allclose(rotation_exp(back), rotation_exp(vector), atol=1e-8)
    else:
        np.testing.assert_allclose(back, vector, atol=1e-13)
    assert np.linalg.norm(back) <= np.pi + 1e-12


@pytest.mark.parametrize("vector", VECTORS)
def test_quaternions_of_every_branch(vector: np.ndarray) -> None:
    rotation = rotation_exp(vector)
    quaternion = quaternion_of(rotation)
    assert quaternion[3] >= 0.0
    assert np.linalg.norm(quaternion) == pytest.approx(1.0, abs=1e-15)
    np.testing.assert_allclose(rotation_of(quaternion), rotation, atol=1e-14)


def test_euler_angles_turn_about_fixed_x_then_y_then_z() -> None:
    angles = np.array([0.3, -1.1, 2.0])
    expected = Rotation.from_euler("xyz", angles).as_matrix()  # lower case: fixed axes
    np.testing.assert_allclose(rotation_euler(angles), expected, atol=1e-15)
    quarter = np.pi / 2.0
    np.testing.assert_allclose(
        rotation_euler(np.array([quarter, 0.0, 0.0])) @ [0, 1, 0], [0, 0, 1], atol=1e-15
    )
    np.testing.assert_allclose(
        rotation_euler(np.array([0.0, 0.0, quarter])) @ [1, 0, 0], [0, 1, 0], atol=1e-15
    )


@pytest.mark.parametrize("vector", VECTORS)
def test_euler_angles_of_a_rotation_make_it_again(vector: np.ndarray) -> None:
    rotation = rotation_exp(vector)
    angles = euler_of(rotation)
    np.testing.assert_allclose(rotation_euler(angles), rotation, atol=1e-14)
    assert abs(angles[1]) <= 0.5 * np.pi


@pytest.mark.parametrize("b", [-0.5 * np.pi, 0.5 * np.pi])
def test_euler_angles_where_two_axes_are_one(b: float) -> None:
    rotation = rotation_euler(np.array([0.4, b, -1.3]))
    angles = euler_of(rotation)
    assert angles[2] == 0.0
    np.testing.assert_allclose(rotation_euler(angles), rotation, atol=1e-9)


def test_cross_matrix_is_the_cross_product() -> None:
    a, b = np.random.default_rng(1).normal(size=(2, 3))
    np.testing.assert_allclose(cross_matrix(a) @ b, np.cross(a, b), atol=1e-15)
