"""Emio against exact rods: numbers of the facts in the reference folder, emio.md, section 9.

Those rods bend, twist and stretch and have no shear; so these strips have none here, either.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from softsim_core.base import Array
from softsim_core.control.inverse import PositionTask, analytic_sensitivity, sampled_sensitivity, solve_pose
from softsim_core.physics.fem.rods import BENDING, RodGroup
from softsim_core.physics.mechanics import rotation_log
from softsim_core.scene import (
    MaterialDescription,
    RodClampDescription,
    RodSectionDescription,
    SceneDescription,
)
from softsim_core.scene.io import load_yaml
from softsim_core.simulation import Simulation

FILE = Path(__file__).resolve().parents[2] / "configs" / "robots" / "emio.yaml"
QUARTER = 1.5708
CAD = {
    (0.0, 0.0, 0.0, 0.0): ((0.0, 0.0, -137.51), (0.0, 0.0, 0.0)),
    (0.8, -0.8, 0.8, -0.8): ((0.0, 0.0, -102.86), (0.0, 0.0, 0.0)),
    (1.374, -1.374, 1.374, -1.374): ((0.0, 0.0, -83.96), (0.0, 0.0, 0.0)),
    (QUARTER, QUARTER, QUARTER, QUARTER): ((0.0, 0.0, -113.58), (0.0, 0.0, 0.0)),
    (1.2, -0.6, 0.6, -0.6): ((0.0, -8.93, -104.51), (-3.78, 0.0, 0.0)),
    (0.0, -1.2, 1.2, 0.0): ((21.13, 21.13, -108.80), (8.66, -8.66, 0.0)),
    (-QUARTER, 0.0, QUARTER, 0.0): ((0.0, 55.59, -124.09), (20.88, 0.0, 0.0)),
}
"""Joint angles in rad, effector in mm and its tilt in deg, with the geometry of the printed parts."""
OTHER = {
    (0.0, 0.0, 0.0, 0.0): (0.0, 0.0, -145.91),
    (0.8, -0.8, 0.8, -0.8): (0.0, 0.0, -109.95),
    (1.374, -1.374, 1.374, -1.374): (0.0, 0.0, -90.05),
    (QUARTER, QUARTER, QUARTER, QUARTER): (0.0, 0.0, -121.04),
    (1.2, -0.6, 0.6, -0.6): (0.0, -9.52, -111.66),
    (0.0, -1.2, 1.2, 0.0): (22.28, 22.28, -116.14),
    (-QUARTER, 0.0, QUARTER, 0.0): (0.0, 59.12, -131.82),
}
"""The same with another simulator's geometry: longer strips that meet nearer to the axis and higher."""


def unsheared(scene: SceneDescription) -> SceneDescription:
    values = {"young_modulus": 35e6, "poisson_ratio": 0.45, "shear_factor": 100.0}
    stiff = MaterialDescription(law="rod", prony=(), **values)
    return replace(scene, bodies=tuple(replace(body, material=stiff) for body in scene.bodies))


@cache
def emio(elements: int = 10) -> Simulation:
    return Simulation(cut(unsheared(load_yaml(FILE).scene), elements), backend="scipy")


def cut(scene: SceneDescription, elements: int) -> SceneDescription:
    """With so many cells in each strip."""
    bodies = []
    for body in scene.bodies:
        assert body.rod is not None
        bodies.append(replace(body, rod=replace(body.rod, elements=elements)))
    return replace(scene, bodies=tuple(bodies))


@cache
def other() -> Simulation:
    """Section 3 of the facts: 202.44 mm, from 22.0 mm off a servo to 10 mm off the middle, 3 mm above it."""
    scene = unsheared(load_yaml(FILE).scene)
    shear, stretch = 35e6 / 2.9, 35e6 * 50e-6
    bend = (35e6 * 104.17e-12, 35e6 * 416.7e-12)
    given = (stretch, 0.8 * stretch, 0.8 * stretch, *bend, shear * 520.8e-12)
    section = RodSectionDescription(shape="rectangle", size=(0.005, 0.010), stiffness=given)
    line = (
        (0.122, 0.0, 0.0),
        (0.118, 0.0, -0.050),
        (0.098, 0.0, -0.098),
        (0.060, 0.0, -0.132),
        (0.010, 0.0, -0.143),
    )
    bodies = []
    for body in scene.bodies:
        assert body.rod is not None
        rod = replace(body.rod, centreline=line, section=section, length=0.20244, elements=20)
        bodies.append(replace(body, rod=rod))
    attachments = tuple(
        replace(each, frame=replace(each.frame, translation=(0.0, 0.0, -0.146)))
        if each.to == "free"
        else each
        for each in scene.attachments
    )
    return Simulation(replace(scene, bodies=tuple(bodies), attachments=attachments), backend="scipy")


@pytest.mark.parametrize(
    ("angles", "elements", "within"),
    [
        pytest.param(angles, *rest, marks=() if rest[0] == 10 or k == 5 else pytest.mark.exhaustive)
        for k, angles in enumerate(CAD)
        for rest in ((10, 0.13), (20, 0.02))
    ],
)
@pytest.mark.slow
def test_check_points_of_the_printed_parts(angles: tuple[float, ...], elements: int, within: float) -> None:
    """What is left at twenty is the rounding of the points, and at the one of a quarter turn the cells."""
    state = emio(elements).equilibrium(angles).state
    place, tilt = CAD[angles]
    assert 1e3 * state.frame_positions[0] == pytest.approx(place, abs=within)
    assert np.degrees(rotation_log(state.frame_rotations[0])) == pytest.approx(tilt, abs=0.1)


@pytest.mark.parametrize(
    "angles",
    [
        pytest.param(angles, marks=() if k in (0, 4, 6) else pytest.mark.exhaustive)
        for k, angles in enumerate(OTHER)
    ],
)
@pytest.mark.slow
def test_check_points_of_another_geometry(angles: tuple[float, ...]) -> None:
    assert 1e3 * other().equilibrium(angles).state.frame_positions[0] == pytest.approx(OTHER[angles], abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("rows", [4, pytest.param(16, marks=pytest.mark.exhaustive)])
def test_it_follows_the_beams_of_another_simulator(reference_dir: Path, rows: int) -> None:
    """Which keep the length of each of nine beams along its chord: bent, their strips are longer by that."""
    file = reference_dir / "emio" / "data" / "sofa_beam_direct2401.csv"
    table = np.genfromtxt(file, delimiter=",", names=True)[:: 720 // rows]
    angles = np.stack([table[f"theta{k}_rad"] for k in range(4)], axis=1)
    places = np.stack([table["sofa_x_mm"], -table["sofa_z_mm"], table["sofa_y_mm"]], axis=1)
    simulation = Simulation(cut(other().scene, 18), backend="scipy")
    (group,) = simulation.model.groups
    assert isinstance(group, RodGroup)
    line, beam = group.line, 0.20244 / 9
    straight = line.natural[..., 0].copy()
    off = []
    for commands, place in zip(angles, places, strict=True):
        line.natural[..., 0] = straight
        state = simulation.equilibrium(commands).state
        for _ in range(2):
            strains, _ = line.strains(line.products(line.vectors(state.positions, group.cells)))
            bent = strains[..., BENDING] + line.natural[..., BENDING]
            line.natural[..., 0] = straight + ((beam * bent) ** 2).sum(axis=-1) / 24.0
            state = simulation.equilibrium(commands, start=state).state
        off.append(np.linalg.norm(1e3 * state.frame_positions[0] - place))
    assert len(off) == rows
    assert np.median(off) < 0.2


@pytest.mark.parametrize("seed", range(3))
def test_a_quarter_turn_of_the_commands_turns_the_robot(seed: int) -> None:
    """Servo i + 1 is servo i turned by 90 degrees, and lifts with the other sign."""
    angles = np.random.default_rng(seed).uniform(-0.3, 1.2, 4) * np.array([1.0, -1.0, 1.0, -1.0])
    commands = (angles, -np.roll(angles, 1))
    here, turned = (emio().equilibrium(each).state.frame_positions[0] for each in commands)
    x, y, z = here
    assert turned == pytest.approx((-y, x, z), abs=2e-6)


@pytest.mark.slow
def test_what_the_strips_ask_of_the_servos() -> None:
    """Section 2: at most 0.11 N m in the data."""
    efforts = [np.abs(emio().equilibrium(angles).state.joint_efforts).max() for angles in CAD]
    assert min(efforts) > 0.01
    assert max(efforts) < 0.2


@cache
def clamped() -> Simulation:
    """With clamps as stiff as walls."""
    scene = load_yaml(FILE).scene
    stiff = RodClampDescription(rotation=(1e6, np.inf, np.inf))
    bodies = [replace(each, rod=replace(each.rod, start_clamp=stiff)) for each in scene.bodies if each.rod]
    return Simulation(replace(scene, bodies=tuple(bodies)), backend="scipy")


@pytest.mark.parametrize("seed", range(4))
def test_stiff_clamps_change_nothing_however_far_servos_turn_at_once(seed: int) -> None:
    """A clamp is a cell of 0.19 mm; that which is torn by a turn leads to other equilibria, 20 mm away."""
    angles = np.random.default_rng(seed).uniform(-0.3, 1.4, 4) * np.array([1.0, -1.0, 1.0, -1.0])
    plain, stiff = emio_as_it_is().equilibrium(angles), clamped().equilibrium(angles)
    assert stiff.state.frame_positions[0] == pytest.approx(plain.state.frame_positions[0], abs=1e-4)
    assert stiff.iterations < 60


def steps(backend: str) -> Array:
    simulation = Simulation(load_yaml(FILE).scene, backend=backend)  # type: ignore[arg-type]
    for k in range(30):
        lift = 0.05 * k
        simulation.command([lift, -0.7 * lift, 0.8 * lift, -lift])
        simulation.step()
    return simulation.positions


@pytest.mark.slow
def test_both_implementations_step_alike() -> None:
    assert np.abs(steps("numba") - steps("scipy")).max() < 1e-9


@pytest.mark.parametrize("backend", ["scipy", pytest.param("numba", marks=pytest.mark.numba)])
def test_derivatives_by_the_servos_are_those_of_equilibria(backend: str) -> None:
    simulation = Simulation(load_yaml(FILE).scene, backend=backend)  # type: ignore[arg-type]
    simulation.settle([0.9, -0.4, 0.6, -0.8])
    exact, sampled = analytic_sensitivity(simulation), sampled_sensitivity(simulation, np.full(4, 1e-5))
    assert np.abs(exact.effector - sampled.effector).max() < 1e-4 * np.abs(sampled.effector).max()
    assert np.abs(exact.effort - sampled.effort).max() < 1e-3 * np.abs(sampled.effort).max()


@pytest.mark.slow
def test_statics_find_the_angles_for_a_place_of_the_centre() -> None:
    pytest.importorskip("daqp")
    goal = np.array([0.015, -0.010, -0.105])
    found = solve_pose(load_yaml(FILE), PositionTask(goal, np.ones(3)))
    assert found.reachable
    assert emio_as_it_is().equilibrium(found.joints).state.frame_positions[0] == pytest.approx(goal, abs=1e-4)


@pytest.mark.parametrize("seed", range(2))
def test_without_weight_legs_up_is_the_mirror_image_of_legs_down(seed: int) -> None:
    angles = np.random.default_rng(seed).uniform(-0.2, 0.8, 4) * np.array([1.0, -1.0, 1.0, -1.0])
    where = []
    for name, sign in (("emio", 1.0), ("emio_up", -1.0)):
        scene = replace(load_yaml(FILE.with_stem(name)).scene, gravity=(0.0, 0.0, 0.0))
        state = Simulation(scene, backend="scipy").equilibrium(sign * angles).state
        into_slots = state.frame_rotations[0] @ np.array([0.0, 0.0, 0.00163])
        where.append(state.frame_positions[0] + into_slots)
    assert where[1] == pytest.approx(where[0] * np.array([1.0, 1.0, -1.0]), abs=1e-6)


@pytest.mark.parametrize("name", ["emio", "emio_up"])
def test_its_first_state_is_nearly_its_equilibrium(name: str) -> None:
    simulation = Simulation(load_yaml(FILE.with_stem(name)).scene, backend="scipy")
    rest = simulation.equilibrium([0.0] * 4)
    assert np.abs(simulation.positions - rest.state.positions).max() < 2e-4


@pytest.mark.slow
def test_strips_of_quadratic_tetrahedra_hang_as_rods_do() -> None:
    """They are held to their shape at both ends, so they do not contract there as rods may: 0.35 mm."""
    strips = Simulation(load_yaml(FILE.with_stem("emio_quadratic")).scene, backend="scipy")
    places = [each.equilibrium([0.0] * 4).state.frame_positions[0] for each in (strips, emio_as_it_is())]
    assert np.linalg.norm(places[1] - places[0]) < 4e-4


@cache
def emio_as_it_is() -> Simulation:
    return Simulation(load_yaml(FILE).scene, backend="scipy")
