"""How the robot looks on the page: colours of stress, sections, ghost, trail, shadow, camera."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from drawn_canvas import Canvas

from softsim_core import load_scene
from softsim_core.scene import STRESS_MAPS, Section, StressMap, ViewSettings
from softsim_ros.nodes.viewer import (
    BANDS,
    CELLS,
    Part,
    Picture,
    SurfaceView,
    Trail,
    band_colours,
    find_covered_pixels,
    for_window,
    landmarks,
    select_visible,
    shade,
    spread_over,
)

pytestmark = pytest.mark.ros


@pytest.mark.parametrize("stress_map", STRESS_MAPS)
def test_band_colours_grow_lighter_or_are_lightest_in_the_middle(stress_map: StressMap) -> None:
    lightness = [0.2126 * r + 0.7152 * g + 0.0722 * b for r, g, b in band_colours(stress_map)]
    assert len(lightness) == BANDS
    top = int(np.argmax(lightness))
    assert top == (BANDS - 1 if stress_map != "coolwarm" else BANDS // 2 - 1)
    assert lightness == [*sorted(lightness[: top + 1]), *sorted(lightness[top + 1 :], reverse=True)]


def test_a_section_takes_away_what_lies_beyond_it() -> None:
    points = np.array([[x, 0.0, z] for x in (0.0, 10.0, 20.0) for z in (0.0, 1.0)], np.float32)
    triangles = np.array([[0, 1, 2], [2, 3, 4], [3, 4, 5]])
    assert select_visible(points, triangles, None) is triangles
    assert select_visible(points, triangles, Section(axis="x", at=0.014)).tolist() == [[0, 1, 2], [2, 3, 4]]
    assert len(select_visible(points, triangles, Section(axis="z", at=-0.001))) == 0


def test_a_surface_shows_its_ghost_and_is_cut_open() -> None:
    canvas = Canvas()
    surface = SurfaceView(canvas, lambda _: None)
    points = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [30.0, 0.0, 0.0]], np.float32)
    part = Part("block", (0, 4), np.array([[0, 1, 2], [1, 3, 2]]), (0.9, 0.8, 0.7, 1.0))
    surface.show([part], points)
    assert "/ghost/block" not in canvas.drawn
    surface.apply_view(ViewSettings(ghost=True, section=Section(axis="x", at=0.008)))
    assert canvas.drawn["/bodies/block"].faces.tolist() == [[0, 1, 2]]
    moved = points + np.float32(5.0)
    surface.update(moved, np.zeros(4, np.float32), now=1.0)
    assert np.array_equal(canvas.drawn["/bodies/block"].vertices, moved)
    assert np.array_equal(canvas.drawn["/ghost/block"].vertices, points)  # it stays at rest
    assert len(surface.triangles) == 0  # all has moved beyond the section
    assert canvas.drawn["/bodies/block"].faces.tolist() == [[0, 0, 0]]


def test_the_way_of_the_effector_is_a_line_of_its_places() -> None:
    canvas = Canvas()
    trail = Trail(canvas)
    for x in (0.0, 0.001, 0.00101, 0.002):
        trail.add((x, 0.0, 0.0))
    assert "/trail" not in canvas.drawn
    trail.switch(True)
    assert canvas.drawn["/trail"].points[:, :, 0].tolist() == [[0.0, 1.0], [1.0, 2.0]]
    trail.switch(False)
    assert canvas.drawn["/trail"].removed


def test_a_shadow_lies_below_what_throws_it() -> None:
    points = np.array([[x, y, 50.0] for x in np.linspace(20, 40, 60) for y in np.linspace(-40, -20, 60)])
    dark = shade(find_covered_pixels(points.astype(np.float32), np.zeros(2), 100.0))
    y, x = (np.arange(CELLS) + 0.5) / CELLS * 100.0 - 50.0, (np.arange(CELLS) + 0.5) / CELLS * 100.0 - 50.0
    assert (dark * x).sum() / dark.sum() == pytest.approx(30.0, abs=0.7)
    assert (dark.T * y).sum() / dark.sum() == pytest.approx(-30.0, abs=0.7)
    assert dark.max() == 1.0
    assert dark[CELLS // 2 :, : CELLS // 2].max() < 1e-6
    assert not find_covered_pixels(
        np.full((3, 3), 1e6, np.float32), np.zeros(2), 100.0
    ).any()  # far away: no error


@pytest.mark.parametrize("size", [1.0, 40.0, 400.0])
def test_the_shadow_of_a_large_triangle_has_no_holes(size: float) -> None:
    """Each place that is looked at has another one less than a pixel away."""
    corners = size * np.array([[-0.3, -0.3, 1.0], [0.3, -0.3, 1.0], [-0.3, 0.3, 1.0]], np.float32)
    triangle, pixel = np.array([[0, 1, 2]]), 0.12 * size
    weights = spread_over(corners, triangle, pixel)
    assert weights.sum(axis=1) == pytest.approx(1.0)
    gaps = np.linalg.norm((weights @ corners)[:, None] - weights @ corners, axis=2)
    np.fill_diagonal(gaps, np.inf)
    assert gaps.min(axis=1).max() <= pixel


def test_a_narrow_window_sees_the_robot_from_farther_and_above_the_panel() -> None:
    position, target = (0.0, -300.0, 100.0), (0.0, 0.0, 20.0)
    assert for_window(position, target, 1.6) == (position, target)
    near, at = (np.array(each) for each in for_window(position, target, 0.5))
    assert np.linalg.norm(near - at) == pytest.approx(2.0 * math.dist(position, target))
    assert at[2] < target[2]  # so the robot is higher in the window
    assert at[:2] == pytest.approx(target[:2])


def browser(aspect: float, position: tuple[float, ...], target: tuple[float, ...] = (0.0, 0.0, 0.0)) -> Any:
    camera = SimpleNamespace(aspect=aspect, position=np.array(position), look_at=np.array(target))
    return SimpleNamespace(camera=camera)


def test_the_next_browser_sees_the_scene_as_the_last_one_left_it() -> None:
    first = SimpleNamespace(position=np.array([0.0, -300.0, 100.0]), look_at=np.array([0.0, 0.0, 20.0]))
    picture: Any = SimpleNamespace(_left={}, _server=SimpleNamespace(initial_camera=first))
    wide = browser(1.6, (1.0, 2.0, 3.0))
    Picture.welcome(picture, wide)
    assert wide.camera.position.tolist() == [1.0, 2.0, 3.0]  # where the server has put it
    Picture.leave(picture, browser(1.6, (9.0, 8.0, 7.0), (1.0, 1.0, 1.0)))
    Picture.welcome(picture, wide)
    assert (wide.camera.position, wide.camera.look_at) == ((9.0, 8.0, 7.0), (1.0, 1.0, 1.0))
    narrow = browser(0.5, (1.0, 2.0, 3.0))
    Picture.welcome(picture, narrow)  # none of its kind has been here: by the first view
    assert np.linalg.norm(narrow.camera.position) > 500.0


@pytest.mark.parametrize(("scene", "count"), [("tripod", 3), ("cable_gripper", 4), ("pneu_finger", 0)])
def test_a_first_view_shows_servos_ends_of_cables_and_loads(scene: str, count: int) -> None:
    assert landmarks(load_scene(scene)).shape == (count, 3)
