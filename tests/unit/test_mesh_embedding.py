"""Barycentric children follow affine motions exactly and are bound to the right element."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from softsim_core.base import MeshError
from softsim_core.physics.mesh import Embedding, SurfaceFollower, SurfaceMesh, TetMesh, box_mesh, embed
from softsim_core.robots import tripod_mesh

BOX = box_mesh((0.06, 0.04, 0.03), (3, 2, 2))


def following(points: np.ndarray, embedding: Embedding) -> SurfaceFollower:
    """Points that follow the nodes of the box."""
    surface = SurfaceMesh(points, np.zeros((0, 3), np.int64), "points")
    return SurfaceFollower([(surface, embedding, 0)], len(BOX.points))


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), spread=st.floats(0.0, 2.0))
def test_affine_fields_are_reproduced_inside_and_outside(seed: int, spread: float) -> None:
    rng = np.random.default_rng(seed)
    points = np.array([0.03, 0.02, 0.015]) + rng.normal(scale=0.01 + 0.03 * spread, size=(20, 3))
    matrix, shift, slope = rng.normal(size=(3, 3)), rng.normal(size=3), rng.normal(size=3)
    embedding = embed(points, BOX)
    follower = following(points, embedding)
    np.testing.assert_allclose(
        follower.follow(BOX.points @ matrix.T + shift), points @ matrix.T + shift, atol=1e-12
    )
    np.testing.assert_allclose(follower.follow(BOX.points @ slope + 3.0), points @ slope + 3.0, atol=1e-12)
    np.testing.assert_allclose(embedding.weights.sum(axis=1), 1.0, atol=1e-12)


def slow_choice(point: np.ndarray, mesh: TetMesh) -> int:
    """The rule in words, one element at a time: smallest d if inside, else the nearest centre."""
    corners = mesh.points[mesh.tets]
    excess = []
    for a, b, c, d in corners:
        local = np.linalg.solve(np.column_stack([b - a, c - a, d - a]), point - a)
        excess.append(max(*-local, local.sum() - 1.0))
    if min(excess) <= 0.0:
        return int(np.argmin(excess))
    return int(np.argmin(((corners.mean(axis=1) - point) ** 2).sum(axis=1)))


@pytest.mark.parametrize("mesh", [BOX, tripod_mesh.tripod_silicone()], ids=["box", "tripod"])
def test_binding_is_that_of_the_plain_search(mesh: TetMesh) -> None:
    rng = np.random.default_rng(7)
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    points = low + (high - low) * rng.uniform(-0.2, 1.2, size=(60, 3))
    embedding = embed(points, mesh)
    assert embedding.tets.tolist() == [slow_choice(point, mesh) for point in points]
    assert 5 < np.count_nonzero(embedding.outside) < 60
    np.testing.assert_array_equal(embedding.nodes, mesh.tets[embedding.tets])


def test_points_of_the_mesh_itself_stay_with_their_node_even_rounded_to_float32() -> None:
    mesh = tripod_mesh.tripod_silicone()
    embedding = embed(mesh.points.astype(np.float32), mesh)
    assert (embedding.weights.max(axis=1) > 1.0 - 1e-5).all()
    nearest = embedding.nodes[np.arange(len(mesh.points)), embedding.weights.argmax(axis=1)]
    np.testing.assert_array_equal(nearest, np.arange(len(mesh.points)))


def test_no_points_is_no_error() -> None:
    points = np.empty((0, 3))
    assert following(points, embed(points, BOX)).follow(BOX.points).shape == (0, 3)


def test_what_cannot_be_embedded_is_refused() -> None:
    with pytest.raises(MeshError, match=r"shape \(1, 2\)"):
        embed(np.zeros((1, 2)), BOX)
    with pytest.raises(MeshError, match="finite"):
        embed(np.array([[0.0, np.nan, 0.0]]), BOX)
    with pytest.raises(MeshError, match="zero volume"):
        embed(np.zeros((1, 3)), TetMesh(BOX.points * [1, 1, 0], BOX.tets))
