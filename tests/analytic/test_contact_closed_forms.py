"""Gaps of spheres, planes and boxes of any thickness in random poses, against independent formulas."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import lsq_linear
from scipy.spatial.transform import Rotation

from softsim_core.physics.contact import CollisionSurface, ContactSettings, Detector, Proximities
from softsim_core.physics.mesh import SurfaceMesh, boundary_surface, box_mesh

REACH = 0.006

seeds = st.integers(0, 100_000)
gaps = st.floats(-0.0025, 0.0055)
examples = settings(max_examples=80, deadline=None, derandomize=True)


def box(half: np.ndarray, cells: tuple[int, int, int] = (1, 1, 1)) -> SurfaceMesh:
    """A box about the origin from half its edges [m]."""
    shape = boundary_surface(box_mesh(tuple(2.0 * half), cells, tuple(-half)))
    return SurfaceMesh(shape.points, shape.triangles, "box")


def detect(*bodies: tuple[np.ndarray, np.ndarray | float]) -> Proximities:
    """Contacts of two bodies, each points with triangles, or with a radius."""
    surfaces: list[CollisionSurface] = []
    first = 0
    for number, (points, shape) in enumerate(bodies):
        surface = CollisionSurface(
            name=f"{number}", vertices=slice(first, first + len(points)), owner=number, radius=1.0
        )
        if isinstance(shape, float):
            surfaces.append(dataclasses.replace(surface, radius=shape))
        else:
            surfaces.append(dataclasses.replace(surface, radius=0.0, triangles=shape + first))
        first += len(points)
    points = np.concatenate([each for each, _ in bodies])
    return Detector(tuple(surfaces), points, ContactSettings().limits()).detect(points, REACH)


def direction(random: np.random.Generator) -> np.ndarray:
    """A random unit vector."""
    vector = random.normal(size=3)
    return vector / np.linalg.norm(vector)


def pose(random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A random rotation (3, 3) and place (3,)."""
    return Rotation.random(random_state=random).as_matrix(), random.uniform(-0.1, 0.1, 3)


def half_edges(random: np.random.Generator) -> np.ndarray:
    """Half the edges of a box in [m]: 0.25 mm to 20 mm each."""
    return 10.0 ** random.uniform(-3.6, -1.7, 3)


def separation(
    between: np.ndarray, first: np.ndarray, second: np.ndarray, sizes: tuple[np.ndarray, np.ndarray]
) -> float:
    """Largest gap of two boxes along the 15 axes that can separate them; negative where they overlap."""
    across = np.cross(first.T[:, None], second.T[None]).reshape(-1, 3)
    axes = np.concatenate([first.T, second.T, across[np.linalg.norm(across, axis=1) > 1e-6]])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return float(
        (np.abs(axes @ between) - np.abs(axes @ first) @ sizes[0] - np.abs(axes @ second) @ sizes[1]).max()
    )


@examples
@given(seeds, gaps)
def test_two_spheres(seed: int, gap: float) -> None:
    random = np.random.default_rng(seed)
    radii = random.uniform(0.003, 0.02, 2)
    centre, along = random.uniform(-0.1, 0.1, 3), direction(random)
    near = detect(
        (centre[None], float(radii[0])), (centre[None] + (radii.sum() + gap) * along, float(radii[1]))
    )
    assert near.distance.tolist() == [pytest.approx(gap, abs=1e-12)]
    np.testing.assert_allclose(near.normal, [-along], atol=1e-9)


@examples
@given(seeds, gaps)
def test_a_sphere_over_a_plane(seed: int, gap: float) -> None:
    random = np.random.default_rng(seed)
    turn, place = pose(random)
    sheet = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]) * 0.05
    radius = float(random.uniform(0.003, 0.02))
    centre = np.append(random.uniform(-0.04, 0.04, 2), radius + gap)
    near = detect(
        (sheet @ turn.T + place, np.array([[0, 1, 2], [0, 2, 3]])), ((turn @ centre + place)[None], radius)
    )
    assert near.distance.tolist() == [pytest.approx(gap, abs=1e-12)]
    np.testing.assert_allclose(near.normal, [-turn[:, 2]], atol=1e-9)


@examples
@given(seeds, gaps)
def test_a_sphere_by_a_box(seed: int, gap: float) -> None:
    """Over a face, an edge or a corner, along a direction in which that is the nearest part."""
    random = np.random.default_rng(seed)
    turn, place = pose(random)
    half, cells = random.uniform(0.004, 0.02, 3), tuple(int(n) for n in random.integers(1, 4, 3))
    radius = float(random.uniform(0.004, 0.02))
    signs = random.integers(-1, 2, 3)
    signs[random.integers(3)] = random.choice([-1, 1])
    spot = np.where(signs == 0, random.uniform(-0.95, 0.95, 3), signs) * half
    outward = signs * random.uniform(0.2, 1.0, 3)
    outward /= np.linalg.norm(outward)
    centre = spot + (radius + gap) * outward
    block = box(half, cells)
    near = detect(((turn @ centre + place)[None], radius), (block.points @ turn.T + place, block.triangles))
    assert near.distance.tolist() == [pytest.approx(gap, abs=1e-12)]
    np.testing.assert_allclose(near.normal, [turn @ outward], atol=1e-9)


@examples
@given(seeds, st.floats(-0.0025, 0.005))
def test_a_box_over_a_plane(seed: int, gap: float) -> None:
    """The gap is the height of the lowest corner; the corners within reach are the contacts."""
    random = np.random.default_rng(seed)
    turn, place = pose(random)
    block = box(random.uniform(0.006, 0.02, 3), tuple(int(n) for n in random.integers(1, 4, 3)))
    points = block.points @ pose(random)[0].T
    points[:, 2] += gap - points[:, 2].min()
    sheet = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]) * 0.2
    near = detect(
        (sheet @ turn.T + place, np.array([[0, 1, 2], [0, 2, 3]])), (points @ turn.T + place, block.triangles)
    )
    assert near.distance.min() == pytest.approx(gap, abs=1e-12)
    np.testing.assert_allclose(near.normal, np.tile(-turn[:, 2], (len(near.key), 1)), atol=1e-9)


@examples
@given(seeds, st.floats(0.0001, 0.005), st.booleans())
@pytest.mark.slow
def test_boxes_of_any_thickness_that_are_apart(seed: int, gap: float, alike: bool) -> None:
    """No contact reaches behind them, however thin: the least gap is the distance of the two boxes."""
    random = np.random.default_rng(seed)
    sizes = half_edges(random), half_edges(random)
    first, second = pose(random)[0], pose(random)[0]
    along = direction(random)
    if alike:  # faces nearly parallel
        second = (
            first @ Rotation.from_rotvec([*random.normal(0.0, 0.05, 2), random.uniform(-3, 3)]).as_matrix()
        )
        along = first[:, 2] + 0.2 * along
    low, high = 0.0, 0.3
    for _ in range(50):
        middle = 0.5 * (low + high)
        closer = separation(middle * along, first, second, sizes) < gap
        low, high = (middle, high) if closer else (low, middle)
    between = high * along
    solution = lsq_linear(
        np.hstack([first, -second]), between, (-np.concatenate(sizes), np.concatenate(sizes)), method="bvls"
    )
    distance = float(np.linalg.norm(solution.fun))
    one, other = box(sizes[0], tuple(int(n) for n in random.integers(1, 4, 3))), box(sizes[1])
    near = detect((one.points @ first.T, one.triangles), (other.points @ second.T + between, other.triangles))
    assert near.distance.min(initial=np.inf) >= gap - 1e-9
    if distance < 0.99 * REACH:
        assert near.distance.min() == pytest.approx(distance, abs=1e-6)


@pytest.mark.parametrize("turn", [20.0, 45.0, 70.0])
def test_sheets_thinner_than_half_the_reach_do_not_meet_with_their_far_edges(turn: float) -> None:
    """The upper edges of the upper sheet over the lower edges of the lower one are no crossing."""
    sheet = box(np.array([0.015, 0.015, 0.00025]), (2, 2, 1))
    matrix = Rotation.from_euler("z", turn, degrees=True).as_matrix()
    near = detect(
        (sheet.points, sheet.triangles), (sheet.points @ matrix.T + [0.004, 0.006, 0.001], sheet.triangles)
    )
    np.testing.assert_allclose(near.distance, 0.0005, atol=1e-12)
    np.testing.assert_allclose(near.normal, np.tile([0.0, 0.0, -1.0], (len(near.key), 1)), atol=1e-9)
    assert len(near.key) >= 8
