"""Rods in steps: both implementations, energy, contact, what they hang on, and what drives them."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from softsim_core.base import Array, Box, MaterialError, MeshError, Placement, SceneError, Sphere, Vector
from softsim_core.lab.identification import ringing
from softsim_core.physics.actuation.cable import CableDescription
from softsim_core.physics.mesh import Shape, box_mesh
from softsim_core.scene import (
    AddedMassDescription,
    AttachmentDescription,
    BodyDescription,
    CollisionDescription,
    JointDescription,
    MaterialDescription,
    RigidBodyDescription,
    RodClampDescription,
    RodDescription,
    RodSectionDescription,
    SceneDescription,
    SolverSettings,
)
from softsim_core.scene.io import load_yaml
from softsim_core.simulation import Simulation

ROUND = RodSectionDescription(shape="ellipse", size=(0.006, 0.006))
MATERIAL = MaterialDescription(law="rod", young_modulus=2e6, poisson_ratio=0.4)


def rod(name: str, start: Vector, end: Vector, **fields: object) -> BodyDescription:
    given = {"section": ROUND, "first_axis": (0.3, 0.2, 0.9), "elements": 6, **fields}
    described = RodDescription(centreline=(start, end), **given)  # type: ignore[arg-type]
    return BodyDescription(name=name, rod=described, material=MATERIAL, density=1100.0)


def at(place: Vector, name: str, body: str, to: str, **fields: object) -> AttachmentDescription:
    return AttachmentDescription(
        name=name,
        body=body,
        to=to,
        sphere=Sphere(center=place, radius=1e-6),
        **fields,  # type: ignore[arg-type]
    )


def two_arms() -> SceneDescription:
    """Two rods from joints to one free frame that a soft block hangs on, a tendon along one of them."""
    left, right = (-0.1, 0.0, 0.0), (0.1, 0.0, 0.0)
    block = box_mesh((0.03, 0.02, 0.02), (3, 2, 2))
    block = replace(block, points=block.points - block.points.mean(axis=0) + np.array([0.0, 0.0, -0.01]))
    routing = tuple((x, 0.0, 0.004) for x in np.linspace(-0.09, -0.01, 5).tolist())
    tendon = CableDescription(body="left", points=routing)
    return SceneDescription(
        name="two_arms",
        bodies=(
            rod("left", left, (0.0, 0.0, 0.0), start_clamp=RodClampDescription(rotation=(0.05, 0.05, 0.1))),
            rod("right", right, (0.0, 0.0, 0.0)),
            BodyDescription(
                name="block",
                mesh=block,
                material=MaterialDescription(young_modulus=5e4, poisson_ratio=0.4),
                density=1000.0,
            ),
        ),
        joints=(
            JointDescription(name="first", base=Placement(translation=left)),
            JointDescription(
                name="second", kind="prismatic", axis=(0.0, 0.0, 1.0), stiffness=200.0, inertia=1e-3
            ),
            JointDescription(name="tendon", kind="cable", actuator=tendon),
        ),
        attachments=(
            at((-0.1001, 0.0, 0.0), "base", "left", "first"),
            at(right, "slide", "right", "second"),
            at((0.0, 0.0, 0.0), "middle", "left", "free"),
            at((0.0, 0.0, 0.0), "other", "right", "middle"),
            AttachmentDescription(
                name="top", body="block", to="middle", box=Box(center=(0.0, 0.0, 0.0), size=(0.1, 0.1, 1e-6))
            ),
        ),
        effector="middle",
    )


@pytest.mark.parametrize("integration", ["implicit_euler", "bossak"])
def test_both_implementations_agree(integration: str) -> None:
    settings = SolverSettings(time_integration=integration, rayleigh_stiffness=0.01)  # type: ignore[arg-type]
    scene = replace(two_arms(), solver=settings)
    fast, readable = (Simulation(scene, backend=each) for each in ("numba", "scipy"))
    rng = np.random.default_rng(2)
    command = np.zeros(3)
    for _ in range(25):
        command += rng.uniform(-1.0, 1.0, 3) * np.array([0.1, 0.002, 0.0006])
        for simulation in (fast, readable):
            simulation.command(command)
            simulation.step()
        assert np.abs(fast.positions - readable.positions).max() < 1e-9
        assert np.abs(fast.joint_efforts - readable.joint_efforts).max() < 1e-6
    assert np.isfinite(fast.von_mises()).all()
    assert fast.von_mises() == pytest.approx(readable.von_mises(), rel=1e-6, abs=1e-3)


@pytest.mark.slow
def test_it_comes_to_rest_at_the_equilibrium() -> None:
    simulation = Simulation(
        replace(two_arms(), solver=SolverSettings(rayleigh_stiffness=0.02)), backend="numba"
    )
    command = [0.4, 0.01, 0.002]
    rest = simulation.equilibrium(command).state
    simulation.command(command)
    for _ in range(400):
        simulation.step()
    assert np.abs(simulation.positions - rest.positions).max() < 1e-7
    # what its drive holds is the slope of the equilibrium's energy along the joint
    assert simulation.joint_efforts == pytest.approx(rest.joint_efforts, rel=1e-3, abs=1e-5)


def test_what_hangs_on_one_frame_moves_as_one() -> None:
    simulation = Simulation(two_arms(), backend="scipy")
    model = simulation.model
    own = [region.nodes for region in model.regions if region.frame == 0]
    assert len(own) == 3
    together = np.concatenate(own)
    before = np.linalg.norm(model.rest[together[:, None]] - model.rest[together], axis=2)
    simulation.command([0.5, 0.02, 0.001])
    for _ in range(20):
        simulation.step()
    after = np.linalg.norm(simulation.positions[together[:, None]] - simulation.positions[together], axis=2)
    assert np.abs(after - before).max() < 1e-12
    assert np.linalg.norm(simulation.positions[together] - model.rest[together], axis=1).min() > 1e-4


def energies(simulation: Simulation) -> tuple[float, float]:
    """Kinetic and elastic energy in [J]."""
    from softsim_core.physics.fem import cell_energy

    model = simulation.model
    kinetic = 0.5 * float((model.mass[:, None] * simulation.velocities**2).sum())
    group = model.groups[0]
    return kinetic, float(
        cell_energy(group, simulation.positions, group.values(simulation.parameters.materials)).sum()
    )


def damped(body: BodyDescription, seconds: float) -> BodyDescription:
    return replace(body, material=MaterialDescription(law="rod", **{**MATERIAL.values, "damping": seconds}))


@pytest.mark.parametrize("integration", ["implicit_euler", "bossak"])
@pytest.mark.slow
def test_both_implementations_damp_rods_alike(integration: str) -> None:
    """Each rod with damping of its own, beside that of the scene, and where steps are iterated."""
    settings = SolverSettings(time_integration=integration, rayleigh_stiffness=0.01)  # type: ignore[arg-type]
    plain = replace(two_arms(), solver=settings)
    left, right, block = plain.bodies
    scene = replace(plain, bodies=(damped(left, 0.03), damped(right, 0.2), block))
    fast, readable, undamped = (
        Simulation(each, backend=backend)
        for each, backend in ((scene, "numba"), (scene, "scipy"), (plain, "scipy"))
    )
    for simulation in (fast, readable, undamped):
        for command in ([0.3, 0.002, 0.001], [0.1, 0.004, 0.0]):
            simulation.command(command)
            for _ in range(6):
                simulation.step()
    assert np.abs(fast.positions - readable.positions).max() < 1e-9
    assert np.abs(undamped.positions - readable.positions).max() > 1e-4


@pytest.mark.parametrize("iterations", [1, 3])
@pytest.mark.slow
def test_a_rod_rings_down_with_its_own_damping(iterations: int) -> None:
    """Two cantilevers in one scene: the damping ratio is c w / 2 of the one, and nothing of the other."""
    settings = SolverSettings(time_integration="bossak", spectral_radius=1.0, iterations=iterations)
    rods = (
        damped(rod("damped", (0.0, 0.0, 0.0), (0.05, 0.0, 0.0), elements=4), 0.0015),
        rod("other", (0.0, 0.1, 0.0), (0.05, 0.1, 0.0), elements=4),
    )
    clamps = tuple(
        AttachmentDescription(name=f"clamp_{each.name}", body=each.name, to="world", end="start")
        for each in rods
    )
    scene = SceneDescription(
        name="two", dt=1e-3, gravity=(0.0, 0.0, 0.0), solver=settings, bodies=rods, attachments=clamps
    )
    simulation = Simulation(scene, backend="numba")
    ends = [len(simulation.positions) // 2 - 1, len(simulation.positions) - 1]
    simulation.forces[ends] = (0.0, 0.0, 3e-3)
    simulation.settle([])
    simulation.forces[ends] = 0.0
    places = []
    for _ in range(400):
        simulation.step()
        places.append(simulation.positions[ends])
    own, other = (ringing(1e-3 * np.arange(400), each) for each in np.swapaxes(places, 0, 1))
    assert own is not None
    assert other is not None
    assert own.damping == pytest.approx(0.0015 * math.pi * other.frequency, rel=0.03)
    assert other.damping == pytest.approx(0.0, abs=1e-3)


@pytest.mark.slow
def test_damping_of_its_own_takes_no_turning_for_a_strain() -> None:
    """Free in space, turning at 4 rounds per second: once it is stretched, much damping hardly slows it."""
    body = damped(rod("rod", (-0.1, 0.0, 0.0), (0.1, 0.0, 0.0), elements=4), 0.05)
    settings = SolverSettings(time_integration="bossak")
    scene = SceneDescription(
        name="spinning", dt=1e-3, gravity=(0.0, 0.0, 0.0), solver=settings, bodies=(body,)
    )
    simulation = Simulation(scene, backend="numba")
    simulation.set_body_velocity("rod", angular_velocity=(0.0, 0.0, 8.0 * math.pi))
    turning = []
    for _ in range(2):
        for _ in range(200):
            simulation.step()
        turning.append(energies(simulation)[0])
    assert turning[1] == pytest.approx(turning[0], rel=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("steps", [2000, pytest.param(10_000, marks=pytest.mark.exhaustive)])
def test_a_spinning_rod_keeps_its_energy(steps: int) -> None:
    """Free in space, turning at 4 rounds per second about an axis across it: 8 or 40 rounds."""
    settings = SolverSettings(time_integration="bossak")
    scene = SceneDescription(
        name="spinning",
        dt=1e-3,
        gravity=(0.0, 0.0, 0.0),
        solver=settings,
        bodies=(rod("rod", (-0.1, 0.0, 0.0), (0.1, 0.0, 0.0), elements=4),),
    )
    simulation = Simulation(scene, backend="numba")
    spin = 2.0 * math.pi * 4.0
    simulation.set_body_velocity("rod", angular_velocity=(0.0, 0.0, spin))
    start = sum(energies(simulation))
    for _ in range(steps):
        simulation.step()
    kinetic, elastic = energies(simulation)
    assert kinetic + elastic == pytest.approx(start, rel=0.01)
    centre = (simulation.model.mass[:, None] * simulation.positions).sum(axis=0) / simulation.model.mass.sum()
    assert np.linalg.norm(centre) < 1e-6


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.slow
def test_it_falls_on_a_table_and_lies_there(seed: int) -> None:
    rng = np.random.default_rng(seed)
    way = rng.standard_normal(3)
    way *= 0.05 / np.linalg.norm(way)
    middle = np.array([0.0, 0.0, 0.03 + abs(way[2])])
    body = rod("rod", tuple((middle - way).tolist()), tuple((middle + way).tolist()), elements=4)
    scene = SceneDescription(
        name="fall",
        dt=0.005,
        solver=SolverSettings(rayleigh_stiffness=0.005),
        bodies=(body,),
        rigid_bodies=(RigidBodyDescription(name="table", shape=Shape(plane=(0.5, 0.5))),),
        collisions=(
            CollisionDescription(name="rod", body="rod"),
            CollisionDescription(name="table", body="table"),
        ),
    )
    simulation = Simulation(scene, backend="numba")
    lowest = []
    for _ in range(400):
        simulation.step()
        lowest.append(float(simulation.visual_points()[:, 2].min()))
        assert simulation.report.positive
    surface = simulation.visual_points()
    gap = simulation.contact_limits.contact_distance
    assert min(lowest) > 0.0
    assert surface[:, 2].min() == pytest.approx(gap, abs=5e-5)
    # it lies on its side: the centre line is half a thickness above the table, all along
    centres = simulation.positions.reshape(-1, 3, 3).mean(axis=1)
    assert centres[:, 2] == pytest.approx(np.full(len(centres), 0.003 + gap), abs=2e-4)
    assert np.linalg.norm(simulation.velocities, axis=1).max() < 0.05


@pytest.mark.parametrize(("speed", "thick", "steps"), [(0.0, 0.006, 16), (20.0, 0.002, 4)])
@pytest.mark.slow
def test_crossing_rods_keep_apart_however_fast(speed: float, thick: float, steps: int) -> None:
    """As capsules would: their axes come no nearer than their thickness; at 20 m/s a step is 50 of these."""
    section = RodSectionDescription(shape="ellipse", size=(thick, thick))
    way = np.array([0.02, 0.045, 0.006])
    over = np.array([0.004, 0.0, 0.03])
    ends = ((-0.05, 0.0, 0.0), (0.05, 0.0, 0.0))
    thrown = rod("thrown", tuple(over - way), tuple(over + way), section=section, elements=4)
    scene = SceneDescription(
        name="crossing",
        dt=0.005,
        solver=SolverSettings(rayleigh_stiffness=0.005),
        bodies=(rod("held", *ends, section=section, elements=4), thrown),
        attachments=tuple(
            AttachmentDescription(name=end, body="held", to="world", end=end) for end in ("start", "end")
        ),
        collisions=tuple(CollisionDescription(name=name, body=name) for name in ("held", "thrown")),
    )
    simulation = Simulation(scene, backend="numba")
    simulation.set_body_velocity("thrown", (0.0, 0.0, -speed))
    nearest, touched = math.inf, False
    for _ in range(steps):
        simulation.step()
        held, other = np.split(simulation.positions.reshape(-1, 3, 3).mean(axis=1), 2)
        nearest = min(nearest, float(np.linalg.norm(along(held)[:, None] - along(other), axis=2).min()))
        touched = touched or bool(simulation.contacts.forces.any())
        for one, next_one in pairwise(along(other)):
            if one[1] * next_one[1] < 0.0:  # where it crosses, it is above
                assert one[2] > np.interp(one[0], held[:, 0], held[:, 2])
    assert touched
    assert nearest > thick


def along(centres: Array) -> Array:
    """Points of the line through the centres of sections, 20 between two of them."""
    at = np.linspace(0.0, len(centres) - 1.0, 20 * (len(centres) - 1) + 1)
    return np.column_stack([np.interp(at, np.arange(len(centres)), each) for each in centres.T])


def test_a_scene_file_holds_rods(tmp_path: Path) -> None:
    file = tmp_path / "rod.yaml"
    file.write_text(
        """
name: rod
bodies:
  - name: arm
    rod:
      centreline: [[0, 0, 0], [0.1, 0, 0]]
      section: {shape: rectangle, size: [0.004, 0.008], end_size: [0.002, 0.004]}
      elements: 4
      start_clamp: {rotation: [0.5, .inf, .inf]}
    material: {young_modulus: 1.0e+6, poisson_ratio: 0.4}
    density: 1000
"""
    )
    robot = load_yaml(file)
    body = robot.scene.bodies[0]
    assert body.rod is not None
    assert body.rod.section.end_size == (0.002, 0.004)
    assert body.material.law == "rod"
    assert Simulation(robot.scene, backend="scipy").positions.shape == (33, 3)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"mesh": box_mesh((1.0, 1.0, 1.0), (1, 1, 1))}, "exactly one of mesh and rod"),
        ({"order": 2}, "a rod takes no order"),
        (
            {"material": MaterialDescription(law="yeoh", c1=1e4, poisson_ratio=0.49)},
            "a rod has the law rod",
        ),
    ],
)
def test_what_a_rod_is_not(change: dict[str, object], sentence: str) -> None:
    with pytest.raises(SceneError, match=sentence):
        replace(rod("rod", (0.0, 0.0, 0.0), (0.1, 0.0, 0.0)), **change)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"centreline": ((0.0, 0.0, 0.0),)}, "two or more points"),
        ({"centreline": ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))}, "none of them twice"),
        ({"centreline": ((0.0, 2.0**63, 0.0), (0.1, 0.0, 0.0), (0.2, 0.0, 0.0))}, "too near for its length"),
        ({"first_axis": (1.0, 0.0, 0.0)}, "first_axis"),
        ({"elements": 0}, "elements must be 1 to 100000"),
        ({"length": 0.2}, "as long as its centreline"),
        ({"end_direction": (1.0, 1.0, 0.0)}, "a direction of length 1"),
    ],
)
def test_rods_that_cannot_be(fields: dict[str, object], sentence: str) -> None:
    given: dict[str, object] = {"centreline": ((0.0, 0.0, 0.0), (0.1, 0.0, 0.0)), "section": ROUND}

    def built() -> Simulation:
        described = RodDescription(**(given | fields))  # type: ignore[arg-type]
        body = BodyDescription(name="rod", rod=described, material=MATERIAL, density=1.0)
        return Simulation(SceneDescription(name="rod", bodies=(body,)), backend="scipy")

    with pytest.raises((SceneError, MeshError), match=sentence):
        built()


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"shape": "rectangle", "size": (0.0, 0.1)}, "size must be > 0 m"),
        ({"shape": "ellipse", "size": (0.01, 0.01), "wall": 0.006}, "less than half"),
        ({"shape": "round", "size": (0.01, 0.01)}, "one of rectangle, ellipse"),
    ],
)
def test_sections_that_cannot_be(fields: dict[str, object], sentence: str) -> None:
    with pytest.raises(SceneError, match=sentence):
        RodSectionDescription(**fields)  # type: ignore[arg-type]


def test_a_clamp_that_cannot_be() -> None:
    with pytest.raises(SceneError, match="three numbers > 0"):
        RodClampDescription(rotation=(0.0, 1.0, 1.0))


def test_rods_alone_have_their_law() -> None:
    block = box_mesh((1.0, 1.0, 1.0), (1, 1, 1))
    with pytest.raises(SceneError, match="the law rod is for rods"):
        BodyDescription(name="block", mesh=block, material=MATERIAL, density=1.0)


def test_added_masses_and_regions_take_whole_sections() -> None:
    body = rod("rod", (0.0, 0.0, 0.0), (0.1, 0.0, 0.0))
    load = AddedMassDescription(mass=0.3, sphere=Sphere(center=(0.1, 0.0, 0.0), radius=1e-6))
    plain, loaded = (
        Simulation(SceneDescription(name="rod", bodies=(each,)), backend="scipy").model.mass
        for each in (body, replace(body, added_masses=(load,)))
    )
    assert loaded - plain == pytest.approx(np.repeat([0.0, 0.1], [len(plain) - 3, 3]))


@pytest.mark.slow
def test_its_surface_follows_it() -> None:
    simulation = Simulation(two_arms(), backend="scipy")
    rest = simulation.visual_points()
    inside = np.linalg.norm(rest[:, 1:], axis=1)[np.abs(rest[:, 0]) > 0.02]
    assert inside.max() == pytest.approx(0.003, rel=1e-6)
    simulation.command([0.6, 0.0, 0.0])
    for _ in range(50):
        simulation.step()
    assert not np.allclose(simulation.visual_points(), rest, atol=1e-3)


def farthest(one: Array, other: Array) -> float:
    return float(np.abs(one - other).max())


@pytest.mark.slow
def test_live_tuning_of_its_material() -> None:
    simulation = Simulation(two_arms(), backend="scipy")
    before = simulation.equilibrium([0.3, 0.0, 0.0]).state.positions
    simulation.set_material("left", bend_1_factor=3.0, bend_2_factor=3.0)
    after = simulation.equilibrium([0.3, 0.0, 0.0]).state.positions
    assert farthest(before, after) > 3e-4
    with pytest.raises(MaterialError, match="bend_1_factor"):
        simulation.set_material("left", bend_1_factor=-1.0)
