"""Contact detection against brute force over all pairs of triangles, in random poses."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from scipy.spatial.transform import Rotation

from softsim_core.physics.contact import CollisionSurface, ContactSettings, Detector, Proximities
from softsim_core.physics.mesh import boundary_surface, box_mesh

SIZE = 0.04
REACH = 0.03

turns = st.tuples(*[st.floats(-3.0, 3.0)] * 3)
seeds = st.integers(0, 10_000)


def block(cells: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray]:
    """A box of 40 mm by 24 mm by 20 mm about the origin, in triangles."""
    shape = boundary_surface(box_mesh((SIZE, 0.024, 0.02), cells))
    return shape.points - shape.points.mean(axis=0), shape.triangles


def pair(first: np.ndarray, second: np.ndarray, cells: tuple[int, int, int]) -> Detector:
    """Two blocks at rest as given, one body each."""
    triangles = block(cells)[1]
    n = len(first)
    return Detector(
        (
            CollisionSurface(name="a", vertices=slice(0, n), triangles=triangles, owner=0),
            CollisionSurface(name="b", vertices=slice(n, 2 * n), triangles=triangles + n, owner=1),
        ),
        np.concatenate([first, second]),
        ContactSettings().limits(),
    )


def segment_distance(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distance of points to segments."""
    along = b - a
    t = np.clip(np.sum((p - a) * along, axis=-1) / np.sum(along * along, axis=-1), 0.0, 1.0)
    return np.linalg.norm(p - a - t[..., None] * along, axis=-1)


def least_distance(points: np.ndarray, first: np.ndarray, second: np.ndarray) -> float:
    """Smallest distance between two sets of triangles, by trying everything."""
    a, b = points[first][:, None], points[second][None]
    found = []
    for left, right in ((a, b), (b, a)):
        normal = np.cross(right[:, :, 1] - right[:, :, 0], right[:, :, 2] - right[:, :, 0])
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        for corner in range(3):
            p = left[:, :, corner]
            height = np.sum((p - right[:, :, 0]) * normal, axis=-1)
            over = np.ones(height.shape, dtype=bool)
            for edge in range(3):
                start, end = right[:, :, edge], right[:, :, (edge + 1) % 3]
                over &= np.sum(np.cross(end - start, p - start) * normal, axis=-1) >= 0.0
                found.append(segment_distance(p, start, end).min())
            found.append(np.where(over, np.abs(height), np.inf).min())
    for i in range(3):
        for j in range(3):
            p, q = a[:, :, i], b[:, :, j]
            d, e = a[:, :, (i + 1) % 3] - p, b[:, :, (j + 1) % 3] - q
            across = np.cross(d, e)
            area = np.sum(across * across, axis=-1)
            s = np.sum(np.cross(q - p, e) * across, axis=-1) / np.maximum(area, 1e-300)
            t = np.sum(np.cross(q - p, d) * across, axis=-1) / np.maximum(area, 1e-300)
            inside = (area > 1e-20) & (s > 0.0) & (s < 1.0) & (t > 0.0) & (t < 1.0)
            gap = np.linalg.norm(p + s[..., None] * d - q - t[..., None] * e, axis=-1)
            found.append(np.where(inside, gap, np.inf).min())
    return float(min(found))


def assert_consistent(near: Proximities, points: np.ndarray) -> None:
    """Weights, points, normals and distances of contacts belong together."""
    np.testing.assert_allclose(near.a_weights.sum(axis=1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(near.b_weights.sum(axis=1), 1.0, rtol=1e-12)
    assert (near.a_weights >= -1e-12).all()
    assert (near.b_weights >= -1e-12).all()
    np.testing.assert_allclose(np.linalg.norm(near.normal, axis=1), 1.0, rtol=1e-12)
    p = np.einsum("kc,kci->ki", near.a_weights, points[near.a])
    q = np.einsum("kc,kci->ki", near.b_weights, points[near.b])
    np.testing.assert_allclose(p - q, near.distance[:, None] * near.normal, atol=1e-9)
    assert len(np.unique(near.key)) == len(near.key)
    assert (np.diff(near.key) > 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("cells", [(1, 1, 1), (4, 3, 2)], ids=["12_triangles", "104_triangles"])
@settings(max_examples=60, deadline=None, derandomize=True)
@given(turns, turns, seeds)
def test_the_nearest_contact_of_apart_blocks_is_the_distance_between_them(cells, first, second, seed) -> None:
    points, triangles = block(cells)
    away = np.random.default_rng(seed).normal(size=3)
    away *= 0.055 / np.linalg.norm(away)  # more than both half diagonals: they never overlap
    a = points @ Rotation.from_rotvec(first).as_matrix().T
    b = points @ Rotation.from_rotvec(second).as_matrix().T + away
    both = np.concatenate([a, b])
    least = least_distance(both, triangles, triangles + len(a))
    assume(least < 0.99 * REACH)
    near = pair(a, b, cells).detect(both, REACH)
    assert_consistent(near, both)
    assert near.distance.min() == pytest.approx(least, rel=1e-9)
    assert (near.normal[near.distance.argmin()] @ away) < 0.0  # from b to a


@settings(max_examples=60, deadline=None, derandomize=True)
@given(turns, seeds)
def test_contacts_turn_with_the_bodies(turn, seed) -> None:
    random = np.random.default_rng(seed)
    points, _ = block((2, 2, 2))
    a = points @ Rotation.random(random_state=seed).as_matrix().T
    b = (
        points @ Rotation.random(random_state=seed + 1).as_matrix().T
        + random.normal(0.0, 0.02, 3)
        + [0.04, 0, 0]
    )
    both = np.concatenate([a, b])
    detector = pair(a, b, (2, 2, 2))
    near = detector.detect(both, 0.01)
    matrix = Rotation.from_rotvec(turn).as_matrix()
    turned = detector.detect(both @ matrix.T + 0.3, 0.01)
    np.testing.assert_array_equal(turned.key, near.key)
    np.testing.assert_allclose(turned.distance, near.distance, atol=1e-12)
    np.testing.assert_allclose(turned.normal, near.normal @ matrix.T, atol=1e-7)


@pytest.mark.slow
@settings(max_examples=40, deadline=None, derandomize=True)
@given(seeds)
def test_the_trees_follow_a_deformation(seed) -> None:
    """A detector built on the deformed shape finds the same as one built on the rest shape."""
    random = np.random.default_rng(seed)
    points, _ = block((6, 4, 3))
    a, b = points, points @ Rotation.random(random_state=seed).as_matrix().T + [0.0, 0.0, 0.024]
    bend = 1.0 + 0.3 * random.normal(size=(3, 3))
    deformed = np.concatenate([a, b]) @ bend + 0.002 * random.normal(size=(2 * len(a), 3))
    near = pair(a, b, (6, 4, 3)).detect(deformed, 0.004)
    fresh = pair(deformed[: len(a)], deformed[len(a) :], (6, 4, 3)).detect(deformed, 0.004)
    np.testing.assert_allclose(np.sort(near.distance), np.sort(fresh.distance), atol=1e-12)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(turns, st.floats(-0.0019, 0.0035), seeds)
def test_a_corner_that_dips_into_a_face_is_pushed_out_along_its_normal(turn, gap, seed) -> None:
    """Never through: the normal is the face's, the distance negative by the depth."""
    random = np.random.default_rng(seed)
    points, _ = block((1, 1, 1))
    matrix = Rotation.from_rotvec(turn).as_matrix()
    tool = points @ Rotation.from_rotvec([0.9, 0.6, 0.3]).as_matrix().T
    tip = tool[:, 2].argmin()
    spot = np.append(random.uniform(-0.005, 0.005, 2), 0.01 + gap)
    tool += spot - tool[tip]
    both = np.concatenate([tool, points]) @ matrix.T
    near = pair(tool, points, (1, 1, 1)).detect(both, 0.004)
    assert_consistent(near, both)
    assert (near.normal @ matrix[:, 2] > 0.0).all()
    deepest = near.distance.argmin()
    assert near.distance[deepest] == pytest.approx(gap, abs=1e-12)
    if abs(gap) > 1e-6:
        np.testing.assert_allclose(near.normal[deepest], matrix[:, 2], atol=1e-6)
