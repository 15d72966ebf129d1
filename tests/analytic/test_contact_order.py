"""Redundant contacts with friction: their forces do not depend on the order in which bodies are listed."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from contact_scenes import FLOOR, touching

from softsim_core import Simulation
from softsim_core.arrays import Array
from softsim_core.mesh.shapes import Shape
from softsim_core.scene.objects import RigidBodyDescription
from softsim_core.values import Placement

BOXES = [
    RigidBodyDescription(
        name=f"box_{k}",
        shape=Shape(box=(0.03, 0.02, 0.01)),
        mass=0.03,
        pose=Placement(
            translation=(0.001 * k, 0.0007 * k, 0.0061 + 0.0111 * k), rotation_deg=(0.0, 0.0, 11.0 * k)
        ),
        velocity=(0.3 if k % 2 else 0.1, 0.05 * k, 0.0),
    )
    for k in range(4)
]
"""A twisted stack whose boxes slide on each other, each on four contacts or more."""


@cache
def way(order: tuple[int, ...]) -> Array:
    """Where each box of the stack is after each of 20 steps in [m], shape (20, 4, 3), whatever the order."""
    simulation = Simulation(touching(FLOOR, *[BOXES[k] for k in order], friction=0.4))
    place, places = np.argsort(order), []
    for _ in range(20):
        simulation.step()
        places.append(simulation._state.rigid_positions[place].copy())
    return np.array(places)


@pytest.mark.parametrize("order", [(3, 2, 1, 0), (1, 3, 0, 2), (2, 0, 3, 1)])
def test_a_sliding_stack_moves_alike_whatever_the_order_of_its_boxes(order: tuple[int, ...]) -> None:
    usual = way((0, 1, 2, 3))
    apart = np.abs(way(order) - usual).max(axis=(1, 2))
    assert np.linalg.norm(usual[-1] - usual[0], axis=1).max() > 0.008
    assert apart[0] < 1e-7
    assert apart.max() < 2e-6
