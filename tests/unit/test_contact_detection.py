"""Contact detection on shapes whose contacts are known."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from softsim_core.physics.contact import CollisionSurface, ContactSettings, Detector, Proximities
from softsim_core.physics.contact.detection import measured_gaps
from softsim_core.physics.mesh import boundary_surface, box_mesh

SETTINGS = ContactSettings(alarm_distance=0.004, contact_distance=0.001).limits()
REACH = 0.004


class Scene:
    """Surfaces over one array of vertices."""

    def __init__(self) -> None:
        self.surfaces: list[CollisionSurface] = []
        self.parts: list[np.ndarray] = []

    def add(self, points: np.ndarray, triangles: np.ndarray, owner: int | None = None, *groups: str) -> slice:
        """Append a surface of triangles; by default of a body of its own."""
        start = sum(map(len, self.parts))
        own = slice(start, start + len(points))
        self.surfaces.append(
            CollisionSurface(
                name=f"surface {len(self.surfaces)}",
                vertices=own,
                triangles=triangles + start,
                owner=len(self.surfaces) if owner is None else owner,
                groups=frozenset(groups),
            )
        )
        self.parts.append(np.asarray(points, dtype=np.float64))
        return own

    def box(self, size: tuple[float, float, float], centre: tuple[float, ...], cells=(1, 1, 1)) -> slice:
        """Append a box."""
        shape = boundary_surface(box_mesh(size, cells))
        return self.add(shape.points - shape.points.mean(axis=0) + centre, shape.triangles)

    def ball(self, radius: float, centre: tuple[float, ...]) -> slice:
        """Append a sphere."""
        start = sum(map(len, self.parts))
        own = slice(start, start + 1)
        name, owner = f"surface {len(self.surfaces)}", len(self.surfaces)
        self.surfaces.append(CollisionSurface(name=name, vertices=own, owner=owner, radius=radius))
        self.parts.append(np.array([centre], dtype=np.float64))
        return own

    @property
    def points(self) -> np.ndarray:
        """All vertices."""
        return np.concatenate(self.parts)

    def detect(self, reach: float = REACH) -> Proximities:
        """Contacts in the pose of the construction."""
        return Detector(tuple(self.surfaces), self.points, SETTINGS).detect(self.points, reach)


def plane(scene: Scene, half: float = 0.1) -> slice:
    """Two triangles at z = 0 that look up."""
    corners = np.array([[-half, -half, 0.0], [half, -half, 0.0], [half, half, 0.0], [-half, half, 0.0]])
    return scene.add(corners, np.array([[0, 1, 2], [0, 2, 3]]))


@pytest.mark.parametrize("gap", [0.0035, 0.001, 0.0, -0.0015])
def test_a_cube_on_a_plane_stands_on_its_four_corners(gap: float) -> None:
    scene = Scene()
    plane(scene)
    scene.box((0.04, 0.04, 0.04), (0.003, 0.007, 0.02 + gap))
    near = scene.detect()
    np.testing.assert_allclose(near.distance, gap, atol=1e-15)
    np.testing.assert_allclose(
        near.normal, [[0.0, 0.0, -1.0]] * len(near.key), atol=1e-12
    )  # down: a is the plane
    corners = {int(b[weights.argmax()]) for b, weights in zip(near.b, near.b_weights, strict=True)}
    assert len(corners) == len(near.key) == 4


def test_two_bricks_laid_crosswise_touch_where_their_edges_cross() -> None:
    scene = Scene()
    scene.box((0.08, 0.02, 0.02), (0.0, 0.0, 0.0))
    scene.box((0.02, 0.08, 0.02), (0.0, 0.0, 0.022))
    near = scene.detect()
    np.testing.assert_allclose(near.distance, 0.002, atol=1e-12)
    np.testing.assert_allclose(near.normal, [[0.0, 0.0, -1.0]] * 4, atol=1e-9)
    spots = np.einsum("kc,kci->ki", near.a_weights, scene.points[near.a])[:, :2]
    assert {tuple(np.round(spot, 9)) for spot in spots} == {
        (x, y) for x in (-0.01, 0.01) for y in (-0.01, 0.01)
    }


@pytest.mark.parametrize("gap", [0.003, 0.0005, -0.001, -0.0014])
def test_thin_sheets_see_each_other_s_near_side_only(gap: float) -> None:
    scene = Scene()
    scene.box((0.06, 0.06, 0.002), (0.0, 0.0, 0.0), (5, 5, 1))
    scene.box((0.06, 0.06, 0.002), (0.004, 0.003, 0.002 + gap), (4, 4, 1))
    near = scene.detect(0.005)
    facing = np.abs(near.normal[:, 2]) > 0.999
    assert (near.normal[facing, 2] < 0.0).all()
    np.testing.assert_allclose(near.distance[facing], gap, atol=1e-12)
    assert facing.sum() >= 16


@pytest.mark.parametrize(
    ("centre", "distance", "normal"),
    [
        pytest.param((0.0, 0.0, 0.027), 0.002, (0, 0, 1), id="face"),
        pytest.param((0.0, 0.0, 0.024), -0.001, (0, 0, 1), id="face_pressed"),
        pytest.param((0.0, 0.0, 0.0195), -0.0055, (0, 0, 1), id="centre_below_the_face"),
        pytest.param((0.024, 0.0, 0.024), 0.004 * 2**0.5 - 0.005, (1, 0, 1), id="edge"),
        pytest.param((0.024, 0.024, 0.024), 0.004 * 3**0.5 - 0.005, (1, 1, 1), id="corner"),
    ],
)
@pytest.mark.parametrize("ball_first", [True, False])
def test_a_ball_on_a_cube(centre, distance: float, normal, ball_first: bool) -> None:
    scene = Scene()
    if ball_first:
        scene.ball(0.005, centre)
    scene.box((0.04, 0.04, 0.04), (0.0, 0.0, 0.0))
    if not ball_first:
        scene.ball(0.005, centre)
    near = scene.detect()
    assert near.distance.tolist() == [pytest.approx(distance, abs=1e-12)]
    outward = np.array(normal) / np.linalg.norm(normal)
    np.testing.assert_allclose(near.normal[0], outward if ball_first else -outward, atol=1e-9)


@pytest.mark.parametrize("seed", range(8))
def test_the_gap_of_features_is_the_distance_that_was_found_and_follows_them(seed: int) -> None:
    """Balls, faces, corners and edges: what a contact lost within a step is measured by."""
    random = np.random.default_rng(seed)
    scene = Scene()
    scene.box((0.04, 0.04, 0.04), (0.0, 0.0, 0.0))
    scene.box((0.02, 0.06, 0.02), (0.0, 0.0, 0.0305))  # across the first one: edges cross
    scene.ball(0.005, (0.0, 0.0, -0.026))
    first, second = random.uniform(0.003, 0.006, 2)
    scene.ball(first, (0.03, 0.0, 0.0))
    scene.ball(second, (0.03, first + second + random.uniform(-0.001, 0.003), 0.0))
    detector, points = Detector(tuple(scene.surfaces), scene.points, SETTINGS), scene.points
    radius = np.zeros(len(points))
    for surface in scene.surfaces:
        radius[surface.vertices] = surface.radius
    contacts = detector.detect(points, REACH)
    assert len(np.unique(contacts.pair, axis=0)) >= 3
    nothing = contacts.select(np.zeros(len(contacts.key), dtype=np.bool_))
    gaps, others = measured_gaps(contacts, nothing, points, radius, REACH)
    np.testing.assert_allclose(gaps, contacts.distance, rtol=0.0, atol=1e-12)
    assert len(others.key) == 0
    balls = np.flatnonzero((radius[contacts.a[:, 0]] > 0.0) & (radius[contacts.b[:, 0]] > 0.0))
    far = points.copy()
    far[-1] += (0.0, 0.02, 0.0)  # beyond reach
    gaps, _ = measured_gaps(contacts, detector.detect(far, REACH), far, radius, REACH)
    apart = np.linalg.norm(far[-1] - far[-2]) - first - second
    np.testing.assert_allclose(gaps[balls], apart, rtol=0.0, atol=1e-12)


def test_balls_touch_balls() -> None:
    scene = Scene()
    scene.ball(0.010, (0.0, 0.0, 0.0))
    scene.ball(0.005, (0.0, 0.016, 0.0))
    near = scene.detect()
    assert near.distance.tolist() == [pytest.approx(0.001)]
    np.testing.assert_allclose(near.normal, [[0.0, -1.0, 0.0]], atol=1e-12)


def test_a_ball_in_a_corner_touches_every_wall() -> None:
    scene = Scene()
    for axis in range(3):
        corners = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 0.1, 0.0], [0.0, 0.1, 0.0]])
        scene.add(np.roll(corners, axis, axis=1), np.array([[0, 1, 2], [0, 2, 3]]))
    scene.ball(0.005, (0.006, 0.007, 0.008))
    near = scene.detect()
    assert sorted(near.distance) == pytest.approx([0.001, 0.002, 0.003])
    np.testing.assert_allclose(np.abs(near.normal).sum(axis=1), 1.0, atol=1e-9)


@pytest.mark.parametrize("height", [0.0005, 0.002])
def test_a_ball_rolls_over_the_edge_between_coplanar_triangles(height: float) -> None:
    scene = Scene()
    plane(scene)
    scene.ball(0.003, (0.02, 0.02, 0.003 + height))  # over the diagonal
    near = scene.detect()
    assert near.distance.tolist() == [pytest.approx(height)]
    np.testing.assert_allclose(near.normal, [[0.0, 0.0, -1.0]], atol=1e-9)


@pytest.mark.parametrize("ball_first", [True, False])
def test_every_vertex_of_a_dent_as_round_as_the_ball_is_met(ball_first: bool) -> None:
    scene = Scene()
    centre, radius, gap = np.array([0.0, 0.0, 0.0206]), 0.02, 0.001
    along = np.linspace(-0.01, 0.01, 11)
    x, y = (each.ravel() for each in np.meshgrid(along, along, indexing="ij"))
    z = centre[2] - np.sqrt((radius + gap) ** 2 - x**2 - y**2)
    start = (11 * np.arange(10)[:, None] + np.arange(10)).ravel()
    triangles = np.stack([start, start + 11, start + 12, start, start + 12, start + 1], axis=1).reshape(-1, 3)
    if ball_first:
        scene.ball(radius, tuple(centre))
    dent = scene.add(np.column_stack([x, y, z]), triangles)
    if not ball_first:
        scene.ball(radius, tuple(centre))
    few = len(scene.detect().key)
    number = int(ball_first)
    scene.surfaces[number] = dataclasses.replace(scene.surfaces[number], soft=True)
    near = scene.detect()
    side, weights = (near.b, near.b_weights) if ball_first else (near.a, near.a_weights)
    corner = weights.max(axis=1) == 1.0
    assert sorted(side[corner, 0]) == list(range(dent.start, dent.stop))
    np.testing.assert_allclose(near.distance[corner], gap, atol=1e-12)
    np.testing.assert_allclose(near.distance, gap, atol=0.002**2 / radius)  # chords sag
    assert few < len(near.key)
    assert len(np.unique(near.key)) == len(near.key)


def test_vertices_that_look_away_from_the_ball_do_not_meet_it() -> None:
    """The far side of a sheet thinner than the contact distance."""
    scene = Scene()
    scene.box((0.02, 0.02, 0.0004), (0.0, 0.0, 0.0), (4, 4, 1))
    scene.surfaces[0] = dataclasses.replace(scene.surfaces[0], soft=True)
    scene.ball(0.01, (0.001, 0.0, 0.0109))
    near = scene.detect()
    assert len(near.key) >= 1
    assert (near.normal[:, 2] < 0.0).all()
    touched = np.einsum("kc,kci->ki", near.a_weights, scene.points[near.a])
    np.testing.assert_allclose(touched[:, 2], 0.0002, atol=1e-9)


def test_walls_of_one_body_meet_only_where_they_were_apart_at_rest() -> None:
    """Two walls of a notch that start from one line: near the line they never count."""
    scene = Scene()
    wall = np.array([[0.0, 0.0, 0.0], [0.0, 0.01, 0.0], [0.02, 0.01, 0.0], [0.02, 0.0, 0.0]])
    triangles = np.array([[0, 3, 2], [0, 2, 1]])  # looks to +z
    other = wall @ np.array([[0.6, 0.0, 0.8], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    scene.add(wall, triangles, 0, "1")
    scene.add(other, triangles[:, ::-1], 0, "2")
    rest = scene.points
    detector = Detector(tuple(scene.surfaces), rest, SETTINGS)
    assert len(detector.detect(rest, REACH).key) == 0
    closed = rest.copy()
    closed[4:] = wall + np.outer([0, 0, 1, 1], [0.0, 0.0, 0.002])
    near = detector.detect(closed, REACH)
    assert near.distance.min() == pytest.approx(0.002, rel=0.02)
    assert (near.normal[:, 2] < -0.9).all()


def test_contacts_keep_their_keys_while_things_move_a_little() -> None:
    scene = Scene()
    plane(scene)
    box = scene.box((0.04, 0.04, 0.04), (0.003, 0.007, 0.022))
    points = scene.points
    detector = Detector(tuple(scene.surfaces), points, SETTINGS)
    before = detector.detect(points, REACH)
    points[box] += [1e-4, 2e-4, -1e-4]
    after = detector.detect(points, REACH)
    np.testing.assert_array_equal(before.key, after.key)
    again = Detector(tuple(scene.surfaces), scene.points, SETTINGS).detect(points, REACH)
    for one, other in zip(after, again, strict=True):
        np.testing.assert_array_equal(one, other)


def test_more_contacts_than_there_was_room_for_are_all_found() -> None:
    scene = Scene()
    scene.box((0.06, 0.06, 0.004), (0.0, 0.0, 0.0), (30, 30, 1))
    scene.box((0.06, 0.06, 0.004), (0.0003, 0.0002, 0.005), (30, 30, 1))
    assert len(scene.detect(0.002).key) > 1700


@pytest.mark.slow
def test_plain_python_finds_what_the_compiled_kernels_find() -> None:
    """Without Numba the same functions run uncompiled."""
    code = (
        "import json\n"
        "from test_contact_detection import Scene, plane\n"
        "scene = Scene()\n"
        "plane(scene)\n"
        "scene.box((0.04, 0.04, 0.04), (0.003, 0.007, 0.021))\n"
        "scene.ball(0.004, (0.026, 0.0, 0.02))\n"
        "print(json.dumps([each.tolist() for each in scene.detect()]))\n"
    )
    scene = Scene()
    plane(scene)
    scene.box((0.04, 0.04, 0.04), (0.003, 0.007, 0.021))
    scene.ball(0.004, (0.026, 0.0, 0.02))
    answer = subprocess.run(
        [sys.executable, "-c", code],
        env={
            **os.environ,
            "NUMBA_DISABLE_JIT": "1",
            "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path]),
        },
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    for plain, compiled in zip(json.loads(answer.stdout), scene.detect(), strict=True):
        np.testing.assert_allclose(plain, compiled, atol=1e-12)
