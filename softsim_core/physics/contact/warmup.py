"""Run of every contact kernel, to fill Numba's cache."""

from __future__ import annotations

import numpy as np

from softsim_core.physics.contact.detection import Closeness, Detector, measured_gaps
from softsim_core.physics.contact.settings import ContactSettings
from softsim_core.physics.contact.solver import solve_contacts
from softsim_core.physics.contact.surfaces import CollisionSurface


def warm_up_contact() -> None:
    """Run every contact kernel once on two triangles and two spheres that touch."""
    points = np.array(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 1, 1], [1, 0, 1], [0.2, 0.2, 2], [0.2, 0.2, 4]]
    ).astype(np.float64)
    low = CollisionSurface(name="low", vertices=slice(0, 3), triangles=np.array([[0, 1, 2]]), owner=0)
    high = CollisionSurface(name="high", vertices=slice(3, 6), triangles=np.array([[3, 4, 5]]), owner=1)
    balls = tuple(
        CollisionSurface(name="ball", vertices=slice(6 + k, 7 + k), owner=2 + k, radius=0.9) for k in range(2)
    )
    detector = Detector((low, high, *balls), points, ContactSettings().limits())
    near = detector.detect(points, 1.5)
    detector.edges_again(near.key, points)
    detector.free_share(points, points, np.ones(len(detector.pairs), dtype=np.bool_))
    measured_gaps(near, near.select(np.zeros(0, dtype=np.int64)), points, np.zeros(len(points)), 1.5)
    detector.may_hold(near, points, points, points, Closeness(0.4, 0.1, 0.1, 1e-5), True, True)
    detector.any_astray(near, np.ones(3 * len(near.key)), points, points, 1e-5)
    rows = 1 + 3 * len(near.key)
    solve_contacts(
        np.eye(rows), np.full(rows, -1.0), (np.zeros(1), np.ones(1)), 0.5, np.zeros(rows), 10, 1e-9
    )
