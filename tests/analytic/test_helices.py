"""Statics of rods that are drawn, wound or curved as a helix: they are found, in few iterations."""

from __future__ import annotations

import math

import numpy as np
import pytest

from softsim_core.base import Array, Vector
from softsim_core.physics.actuation.cable import CableDescription
from softsim_core.physics.dynamics import StaticSolution
from softsim_core.scene import (
    AttachmentDescription,
    BodyDescription,
    JointDescription,
    MaterialDescription,
    RodDescription,
    RodSectionDescription,
    SceneDescription,
)
from softsim_core.simulation import Simulation

LENGTH, RADIUS = 0.2, 0.02
STRAIGHT = ((0.0, 0.0, 0.0), (LENGTH, 0.0, 0.0))


def simulated(
    rod: RodDescription,
    young_modulus: float,
    gravity: Vector = (0.0, 0.0, 0.0),
    joints: tuple[JointDescription, ...] = (),
) -> Simulation:
    """A rod that is clamped at its start."""
    material = MaterialDescription(law="rod", young_modulus=young_modulus, poisson_ratio=0.3)
    scene = SceneDescription(
        name="helix",
        gravity=gravity,
        bodies=(BodyDescription(name="rod", rod=rod, material=material, density=1200.0),),
        attachments=(AttachmentDescription(name="clamp", body="rod", to="world", end="start"),),
        joints=joints,
    )
    return Simulation(scene, backend="scipy")


def round_section(diameter: float) -> RodSectionDescription:
    return RodSectionDescription(shape="ellipse", size=(diameter, diameter))


def drawn(young_modulus: float, pulled: float = 0.0) -> Simulation:
    """A spring of 3 turns, 40 mm wide and 60 mm high, that hangs from its start; `pulled`: down, in [N]."""
    angles = np.linspace(0.0, 6.0 * math.pi, 37)
    around = [RADIUS * np.cos(angles), RADIUS * np.sin(angles), -0.02 * angles / (2.0 * math.pi)]
    line = tuple(tuple(each) for each in np.column_stack(around).tolist())
    rod = RodDescription(centreline=line, section=round_section(0.004), elements=40)
    spring = simulated(rod, young_modulus, (0.0, 0.0, -9.80665))
    spring.forces[-3:, 2] = -pulled / 3.0
    return spring


def wound(turns: int) -> Simulation:
    """A rod 10 mm thick with a tendon that goes round it so many times, 8 mm from its axis."""
    along = np.linspace(0.0, 1.0, 16 * turns + 1)
    angles = 2.0 * math.pi * turns * along
    points = np.column_stack([LENGTH * along, 0.008 * np.cos(angles), 0.008 * np.sin(angles)])
    tendon = CableDescription(body="rod", points=tuple(tuple(each) for each in points.tolist()))
    rod = RodDescription(centreline=STRAIGHT, section=round_section(0.01), elements=20)
    return simulated(rod, 2e6, joints=(JointDescription(name="tendon", kind="cable", actuator=tendon),))


def centres(solution: StaticSolution) -> Array:
    """Centres of the sections in [m], shape (k, 3)."""
    return np.asarray(solution.state.positions.reshape(-1, 3, 3).mean(axis=1))


@pytest.mark.slow
@pytest.mark.parametrize(("young_modulus", "pulled", "most"), [(5e5, 0.0, 90), (2e7, 1.0, 100)])
def test_a_spring_stretches_in_few_iterations(young_modulus: float, pulled: float, most: int) -> None:
    """To four times its length and more, 62 and 69; 162 and 119 before the cells rotated without strain."""
    spring = drawn(young_modulus, pulled)
    found = spring.equilibrium()
    height = -centres(found)[-1, 2]
    assert height > 4.0 * 0.06
    assert found.iterations < most
    assert found.residual < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize(("turns", "most"), [(1, 90), (3, 20)])
def test_a_wound_tendon_coils_a_rod_in_few_iterations(turns: int, most: int) -> None:
    """Pulled by a quarter of the rod's length, 69 and 12; 165 and 119 before cells rotated without strain."""
    rod = wound(turns)
    found = rod.equilibrium([0.05])
    assert found.state.joint_positions[0] == pytest.approx(0.05, abs=1e-9)
    assert found.iterations < most
    again = rod.equilibrium([0.05], start=wound(turns).equilibrium([0.045]).state)
    assert np.abs(found.state.positions - again.state.positions).max() < 1e-7


@pytest.mark.parametrize("elements", [16, 50])
@pytest.mark.parametrize(("curve", "twist"), [(25.0, 18.0), (10.0, -30.0), (2.0 * math.pi / LENGTH, 0.0)])
def test_a_straight_rod_becomes_the_helix_of_its_natural_shape(
    curve: float, twist: float, elements: int
) -> None:
    """The first state is a turn or more away; 5 or 6 iterations, where straight steps took 57 to 131."""
    rod = RodDescription(
        centreline=STRAIGHT,
        section=RodSectionDescription(shape="rectangle", size=(0.004, 0.006)),
        natural="straight",
        curvature=(curve, 0.0, twist),
        elements=elements,
    )
    found = simulated(rod, 2e7).equilibrium()
    total = math.hypot(curve, twist)
    radius, rise, turn = curve / total**2, twist / total, total * LENGTH
    chord = math.hypot(rise * LENGTH, 2.0 * radius * math.sin(0.5 * turn))
    places = centres(found)
    assert np.linalg.norm(places[-1] - places[0]) == pytest.approx(chord, abs=2e-3 * LENGTH)
    assert found.iterations <= 8
