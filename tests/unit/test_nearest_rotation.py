"""The nearest rotation: compiled, vectorised and by singular values, on every kind of matrix."""

from __future__ import annotations

import numpy as np
import pytest
from small_scenes import body, scene, slab

from softsim_core.base import Array, Backend
from softsim_core.physics.dynamics import make_stepper
from softsim_core.physics.fem.materials import polar_rotations
from softsim_core.physics.mechanics import Control, rotation_exp
from softsim_core.physics.mesh import box_mesh
from softsim_core.scene.building import build

MATRICES = 300


def compiled(matrix: Array) -> Array:
    pytest.importorskip("numba")
    from softsim_core.physics.dynamics.numba_backend import nearest_rotations
    from softsim_core.physics.linalg import LANES

    result = np.empty((9, LANES))
    nearest_rotations(np.repeat(matrix.reshape(9, 1), LANES, axis=1), result)
    return result[:, -1].reshape(3, 3)


def with_stretches(stretches: Array, seed: int) -> Array:
    """Matrices (k, 3, 3) of given principal stretches (k, 3), negative ones inside out, turned at random."""
    rng = np.random.default_rng(seed)
    turns = [rotation_exp(rng.uniform(-1.8, 1.8, 3)) for _ in range(2 * len(stretches))]
    return np.array(turns[::2]) @ (stretches[:, :, None] * np.array(turns[1::2]))


def assert_proper(rotation: Array) -> None:
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


@pytest.mark.parametrize("smallest", [(0.2, 2.0), (-0.15, -0.05), (1e-9, 1e-6), (-1e-6, -1e-9)])
def test_compiled_rotation_is_that_of_the_singular_values(smallest: tuple[float, float]) -> None:
    """Volumes of any size and sign: the least stretch is positive, negative, or next to nothing."""
    rng = np.random.default_rng(0)
    stretches = np.column_stack(
        [rng.uniform(1.0, 3.0, MATRICES), rng.uniform(0.3, 1.0, MATRICES), rng.uniform(*smallest, MATRICES)]
    )
    matrices = with_stretches(stretches, seed=1)
    for matrix, expected in zip(matrices, polar_rotations(matrices), strict=True):
        rotation = compiled(matrix)
        assert_proper(rotation)
        np.testing.assert_allclose(rotation, expected, atol=1e-11)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_random_matrices_of_any_scale(scale: float) -> None:
    """Close to where two rotations are equally near, only their distance to the matrix can agree."""
    matrices = scale * np.random.default_rng(2).normal(size=(MATRICES, 3, 3))
    assert (np.linalg.det(matrices) < 0.0).sum() > MATRICES // 3
    for matrix, expected in zip(matrices, polar_rotations(matrices), strict=True):
        rotation = compiled(matrix)
        assert_proper(rotation)
        nearest, distance = np.linalg.norm(matrix - expected), np.linalg.norm(matrix - rotation)
        assert distance <= nearest * (1.0 + 1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    "matrix",
    [
        np.zeros((3, 3)),
        np.diag([1.0, 0.0, 0.0]),  # a line
        np.diag([0.0, 1.0, 0.0]),
        np.diag([1.0, 1.0, 0.0]),  # a plane
        np.ones((3, 3)),
        -np.eye(3),  # point reflection: every half turn is as near
        np.diag([1.0, 1.0, -1.0]),  # mirror image
        np.diag([1.0, 0.5, -0.5]),  # two rotations are as near
        1e-300 * np.eye(3),
        np.outer([1.0, 2.0, 3.0], [0.0, -1.0, 1.0]),
    ],
)
def test_degenerate_matrices_still_give_a_rotation(matrix: Array) -> None:
    assert_proper(compiled(matrix))
    assert_proper(polar_rotations(matrix[None])[0])


def test_rotations_are_their_own_nearest() -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        rotation = rotation_exp(rng.uniform(-1.8, 1.8, 3))
        np.testing.assert_allclose(compiled(rotation), rotation, atol=1e-14)
        np.testing.assert_allclose(polar_rotations(rotation[None])[0], rotation, atol=1e-14)


@pytest.mark.parametrize("seed", range(5))
def test_one_step_from_a_crumpled_shape_is_the_same_on_both_paths(seed: int) -> None:
    """The element loop of the fast step meets elements of every kind in one vector."""
    pytest.importorskip("numba")
    built = build(
        scene(body(box_mesh((0.04, 0.02, 0.02), (4, 2, 2))), attachments=(slab("wall", "world", 0.0),))
    )
    model, free = built.model, built.model.free_nodes
    positions = np.random.default_rng(seed).uniform(0.0, 0.03, (len(free), 3))
    ends = []
    for backend in ("numba", "scipy"):
        state = model.rest_state()
        state.positions[free] = positions
        make_stepper(model, backend).step(
            state, Control(np.zeros(0), np.zeros_like(model.rest)), built.parameters
        )
        ends.append(state.positions)
    np.testing.assert_allclose(ends[0], ends[1], rtol=0, atol=1e-9)


@pytest.mark.parametrize("shape", ["point", "line", "plane"])
def test_a_collapsed_body_stays_finite(shape: str, backend: Backend) -> None:
    """Elements without volume: from a plane the body finds its shape, from less it may fold another way."""
    block = body(box_mesh((0.04, 0.02, 0.02), (4, 2, 2)))
    built = build(scene(block, rayleigh_mass=5.0, gravity=(0.0, 0.0, 0.0)))
    model, state = built.model, built.model.rest_state()
    state.positions[:] = model.rest * {"point": [0, 0, 0], "line": [1, 0, 0], "plane": [1, 1, 0]}[shape]
    stepper = make_stepper(model, backend)
    control = Control(np.zeros(0), np.zeros_like(model.rest))
    stepper.step(state, control, built.parameters)
    assert np.isfinite(state.buffer).all()
    state.positions += np.random.default_rng(0).normal(scale=1e-4, size=state.positions.shape)
    for _ in range(1000):
        if stepper.step(state, control, built.parameters).top_speed < 1e-7:
            break
    assert np.isfinite(state.buffer).all()
    assert np.abs(state.positions).max() < 0.1
    if shape == "plane":
        size = np.linalg.norm(state.positions - state.positions.mean(axis=0), axis=1)
        rest = np.linalg.norm(model.rest - model.rest.mean(axis=0), axis=1)
        np.testing.assert_allclose(size, rest, atol=1e-5)
