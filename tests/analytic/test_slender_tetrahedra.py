"""Slender bodies of tetrahedra: drawn as rods are, straight without load, and held at their ends."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from softsim_core.base import SceneError
from softsim_core.scene import (
    AddedMassDescription,
    AttachmentDescription,
    BodyDescription,
    MaterialDescription,
    RodClampDescription,
    RodDescription,
    RodSectionDescription,
    SceneDescription,
)
from softsim_core.simulation import Simulation

LENGTH, THICK, WIDE, DENSITY = 0.2, 0.006, 0.010, 1200.0
ANGLES = np.linspace(0.0, 0.25 * np.pi, 4)
ARC = tuple(
    (float(x), 0.0, float(z)) for x, z in 0.24 * np.column_stack([np.sin(ANGLES), np.cos(ANGLES) - 1.0])
)
"""An eighth of a circle, 0.19 m from the origin on, along x and down."""

STRIP = RodDescription(
    centreline=ARC,
    start_direction=(1.0, 0.0, 0.0),
    end_direction=(math.sqrt(0.5), 0.0, -math.sqrt(0.5)),
    section=RodSectionDescription(shape="rectangle", size=(THICK, WIDE)),
    natural="straight",
    length=LENGTH,
    elements=6,
)


def strip(cell: str | None, rod: RodDescription = STRIP, law: str = "stable_neo_hookean") -> BodyDescription:
    material = MaterialDescription(law=law, young_modulus=2e6, poisson_ratio=0.3)
    added = AddedMassDescription(mass=0.01, end="end")
    return BodyDescription(
        name="strip", rod=rod, element=cell, material=material, density=DENSITY, added_masses=(added,)
    )


def held(body: BodyDescription) -> Simulation:
    wall = AttachmentDescription(name="wall", body="strip", to="world", end="start")
    return Simulation(
        SceneDescription(name="strip", gravity=(0.0, 0.0, 0.0), bodies=(body,), attachments=(wall,)),
        backend="scipy",
    )


CELLS = [("tet4", "corotational"), ("tet10", "stable_neo_hookean"), (None, "rod")]


@pytest.mark.parametrize(("cell", "law"), CELLS)
@pytest.mark.slow
def test_it_begins_as_it_is_drawn_and_is_straight_without_load(cell: str | None, law: str) -> None:
    simulation = held(strip(cell, law=law))
    end = simulation.bodies[0].ends
    assert end is not None
    drawn = simulation.positions[end[1]].mean(axis=0)
    assert drawn == pytest.approx(ARC[-1], abs=1e-9)
    rest = simulation.equilibrium().state.positions
    assert rest[end[1]].mean(axis=0) == pytest.approx((LENGTH, 0.0, 0.0), abs=1e-8)
    assert np.ptp(rest[:, 2]) <= THICK + 1e-9


@pytest.mark.parametrize(("cell", "law"), CELLS)
def test_its_mass_is_that_without_load(cell: str | None, law: str) -> None:
    mass = held(strip(cell, law=law)).model.mass.sum()
    assert mass == pytest.approx(DENSITY * THICK * WIDE * LENGTH + 0.01)


def test_what_is_drawn_without_load_stays() -> None:
    simulation = held(strip("tet10", replace(STRIP, natural="as_drawn", length=None)))
    assert simulation.equilibrium().state.positions == pytest.approx(simulation.positions, abs=1e-9)


@pytest.mark.parametrize(
    ("rod", "named"),
    [
        (replace(STRIP, start_clamp=RodClampDescription(rotation=(1.0, 1.0, 1.0))), "start_clamp"),
        (replace(STRIP, curvature=(1.0, 0.0, 0.0)), "curvature"),
        (replace(STRIP, section=replace(STRIP.section, wall=0.001)), "section.wall"),
    ],
)
def test_what_tetrahedra_cannot_be_is_refused(rod: RodDescription, named: str) -> None:
    with pytest.raises(SceneError, match=f"remove {named} or `element`"):
        strip("tet10", rod)


def test_a_law_of_the_other_kind_is_refused() -> None:
    with pytest.raises(SceneError, match="the law rod is for sections"):
        strip("tet10", law="rod")
    with pytest.raises(SceneError, match="element: tet10"):
        strip(None)
