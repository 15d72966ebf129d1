"""Goals for the Tripod, made by forward equilibria, and the robot to reach them with."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from softsim_core import Pose, Simulation, load_scene
from softsim_core.arrays import Array
from softsim_core.inverse.static import effector, place, walk

LOWER, UPPER = -2.0225, -0.0255
"""Joint limits of the Tripod in [rad]."""

MARGIN = 0.1 * (UPPER - LOWER)
"""Goals come from joints at least this far inside the limits."""

START, SHIFT = np.full(3, -1.4965), 0.035
"""Joints in [rad] and base shift in [m] at the end of the start move."""

COUNTS = [12, pytest.param(200, marks=pytest.mark.exhaustive)]
"""How many goals a test goes to: in the suite, and where there is time."""


def tripod_at_start() -> Simulation:
    """The Tripod on the low mesh, at rest where its start move ends, without a start move of its own."""
    simulation = Simulation(replace(load_scene("tripod", kind="robots"), start=None))
    place(simulation, START, SHIFT)
    return simulation


@cache
def goals(count: int, seed: int, reach: float = np.inf) -> list[tuple[Array, Pose]]:
    """Random joints inside the limits, at most `reach` [rad] from the start pose, and the effector there."""
    rng, simulation = np.random.default_rng(seed), tripod_at_start()
    home, found = simulation.snapshot(), []
    lower = np.maximum(LOWER + MARGIN, START - reach)
    upper = np.minimum(UPPER - MARGIN, START + reach)
    for _ in range(count):
        joints = rng.uniform(lower, upper)
        simulation.restore(home)
        if simulation.backend == "numba":
            walk(simulation, joints, SHIFT)
        simulation.settle(joints)
        found.append((joints, effector(simulation)))
    return found
