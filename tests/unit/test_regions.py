"""Boxes and spheres choose nodes, faces included."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from softsim_core.base import Box, Sphere
from softsim_core.scene import nodes_in


def test_a_box_includes_its_faces_edges_and_corners() -> None:
    box = Box(center=(1.0, 2.0, 3.0), size=(2.0, 4.0, 6.0))
    inside = [(0.0, 2.0, 3.0), (2.0, 4.0, 6.0), (1.0, 2.0, 3.0), (0.0, 0.0, 0.0)]
    outside = [(-1e-6, 2.0, 3.0), (1.0, 4.000001, 3.0), (1.0, 2.0, 6.000001)]
    assert nodes_in(box, np.array(outside + inside)).tolist() == [3, 4, 5, 6]


def test_a_box_forgives_rounding() -> None:
    box = Box(center=(0.1, 0.0, 0.0), size=(0.2, 1.0, 1.0))
    assert nodes_in(
        box, np.array([[0.1 + 0.2 / 2 + 1e-16, 0.0, 0.0], [0.1 + 0.1 + 1e-10, 0.0, 0.0]])
    ).tolist() == [0, 1]


def test_a_turned_box_turns_about_its_centre() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-2.0, 2.0, (500, 3))
    angles = (30.0, -50.0, 110.0)
    box = Box(center=(0.2, -0.3, 0.4), size=(1.0, 2.0, 3.0), rotation_deg=angles)
    local = Rotation.from_euler("xyz", angles, degrees=True).inv().apply(points - box.center)
    expected = np.flatnonzero((np.abs(local) <= np.array(box.size) / 2.0).all(axis=1))
    assert len(expected) > 20
    assert nodes_in(box, points).tolist() == expected.tolist()


def test_a_sphere_includes_its_surface() -> None:
    sphere = Sphere(center=(1.0, 0.0, 0.0), radius=0.5)
    points = np.array(
        [[1.5, 0.0, 0.0], [1.0, 0.3, 0.4], [1.0, 0.31, 0.4], [1.0, 0.0, 0.0], [0.499, 0.0, 0.0]]
    )
    assert nodes_in(sphere, points).tolist() == [0, 1, 3]


def test_no_points() -> None:
    assert nodes_in(Sphere(center=(0.0, 0.0, 0.0), radius=1.0), np.zeros((0, 3))).tolist() == []
