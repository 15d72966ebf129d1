"""Scenes of ours as MuJoCo models: the same nodes, the same rest, and back again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from softsim_core import Simulation, load_scene
from softsim_core.base import Box, MjcfError, Placement
from softsim_core.mjcf import MujocoRun, export_mjcf, import_mjcf, write_imported
from softsim_core.physics.actuation.cable import CableDescription
from softsim_core.physics.contact import ContactSettings
from softsim_core.physics.mechanics import JointLimits
from softsim_core.physics.mesh import Shape, box_mesh
from softsim_core.scene import (
    AttachmentDescription,
    BodyDescription,
    CollisionDescription,
    JointDescription,
    MaterialDescription,
    RigidBodyDescription,
    RodDescription,
    RodSectionDescription,
    SceneDescription,
    SolverSettings,
)

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")
LAW = "saint_venant_kirchhoff"
LENGTH, SIDE = 0.12, 0.03
BEAM = BodyDescription(
    name="beam",
    mesh=box_mesh((LENGTH, SIDE, SIDE), (6, 2, 2)),
    material=MaterialDescription(law=LAW, young_modulus=2e5, poisson_ratio=0.3),
    density=1000.0,
)
ROOT = Box(center=(0.0, SIDE / 2, SIDE / 2), size=(1e-4, 1.0, 1.0))
TIP = Box(center=(LENGTH, SIDE / 2, SIDE / 2), size=(1e-4, 1.0, 1.0))
HELD = AttachmentDescription(name="root", body="beam", to="world", box=ROOT)
DAMPED = SolverSettings(rayleigh_stiffness=0.02)


def beam_scene(**fields: object) -> SceneDescription:
    return SceneDescription(
        **{"name": "beam_scene", "bodies": (BEAM,), "attachments": (HELD,), "solver": DAMPED, **fields}
    )


def at_rest(
    scene: SceneDescription, steps: int = 150
) -> tuple[np.ndarray, np.ndarray, Simulation, MujocoRun]:
    """Nodes of ours and of MuJoCo in [m] after some steps."""
    pytest.importorskip("mujoco", minversion="4.0")  # before, flexes are stiffer than their file says
    ours, theirs = Simulation(scene, backend="scipy"), MujocoRun(export_mjcf(scene).text)
    np.testing.assert_allclose(theirs.points(), ours.positions, atol=1e-12)
    for _ in range(steps):
        ours.step()
        theirs.advance()
    return ours.positions, theirs.points(), ours, theirs


@pytest.mark.slow
def test_a_held_beam_rests_where_it_does_here() -> None:
    ours, theirs, *_ = at_rest(beam_scene())
    sag = (BEAM.mesh.points - ours)[:, 2].max()
    assert sag > 5e-3
    np.testing.assert_allclose(theirs, ours, atol=1e-4 * sag)


@pytest.mark.slow
def test_springs_and_equal_masses_do_too() -> None:
    body = replace(BEAM, density=None, total_mass=0.1, mass_distribution="equal")
    soft = replace(HELD, stiffness=200.0)
    ours, theirs, *_ = at_rest(beam_scene(bodies=(body,), attachments=(soft,)), 250)
    sag = (BEAM.mesh.points - ours)[:, 2].max()
    assert sag > 5e-3
    np.testing.assert_allclose(theirs, ours, atol=2e-3 * sag)


@pytest.mark.slow
def test_a_servo_that_gives_way_does_too() -> None:
    servo = JointDescription(
        name="servo",
        base=Placement(translation=(-0.01, SIDE / 2, SIDE / 2), rotation_deg=(0.0, 0.0, 10.0)),
        stiffness=2.0,
        inertia=1e-4,
        rest=0.0,
    )
    scene = beam_scene(joints=(servo,), attachments=(replace(HELD, to="servo"),))
    ours, theirs, simulation, run = at_rest(scene, 200)
    angle = simulation.joint_positions[0]
    assert angle > 0.01
    assert run.data.joint("servo").qpos[0] == pytest.approx(angle, rel=2e-3)
    np.testing.assert_allclose(theirs, ours, atol=5e-5)


@pytest.mark.slow
def test_a_free_frame_and_what_it_carries_swing_alike() -> None:
    tip = AttachmentDescription(
        name="tip", body="beam", to="free", box=TIP, frame=Placement(translation=(LENGTH, 0.0, 0.0))
    )
    plate = RigidBodyDescription(name="plate", shape=Shape(box=(0.01, 0.05, 0.05)), on="tip")
    scene = beam_scene(attachments=(HELD, tip), rigid_bodies=(plate,))
    ours, theirs, simulation, run = at_rest(scene)
    np.testing.assert_allclose(theirs, ours, atol=2e-5)
    np.testing.assert_allclose(run.data.geom("plate").xpos, simulation.rigid_poses[0].position, atol=2e-5)


@pytest.mark.slow
def test_a_cable_bends_it_alike() -> None:
    """By force; its points are nodes, so that nothing is moved to the nearest one."""
    points = tuple((x, SIDE / 2, SIDE) for x in (0.02, 0.06, 0.12))
    cable = JointDescription(
        name="cable",
        kind="cable",
        limits=JointLimits(lower=0.0, upper=5.0),
        actuator=CableDescription(
            body="beam", points=points, pull_point=(-0.02, SIDE / 2, SIDE), control="force"
        ),
    )
    pytest.importorskip("mujoco", minversion="4.0")
    scene = beam_scene(joints=(cable,), gravity=(0.0, 0.0, 0.0))
    ours, theirs = Simulation(scene, backend="scipy"), MujocoRun(export_mjcf(scene).text)
    ours.command([1.0])
    theirs.data.ctrl[0] = 1.0
    for _ in range(150):
        ours.step()
        theirs.advance()
    lift = ours.positions[:, 2].max() - SIDE
    assert lift > 2e-3
    np.testing.assert_allclose(theirs.points(), ours.positions, atol=5e-3 * lift)


@pytest.mark.slow
def test_a_block_falls_onto_a_plane_and_rests() -> None:
    plane = RigidBodyDescription(
        name="plane", shape=Shape(plane=(1.0, 1.0)), pose=Placement(translation=(0, 0, -0.01))
    )
    ball = RigidBodyDescription(
        name="ball", shape=Shape(sphere=0.01), mass=0.01, pose=Placement(translation=(0.3, 0.0, 0.02))
    )
    names = ("beam", "plane", "ball")
    scene = beam_scene(
        attachments=(),
        rigid_bodies=(plane, ball),
        collisions=tuple(CollisionDescription(name=name, body=name) for name in names),
        contact=ContactSettings(contact_distance=0.001),
    )
    ours, theirs, simulation, run = at_rest(scene, 120)
    assert ours[:, 2].min() == pytest.approx(-0.009, abs=3e-4)
    assert theirs[:, 2].min() == pytest.approx(-0.009, abs=1e-3)  # its contact is a spring
    assert run.data.body("ball").xpos[2] == pytest.approx(simulation.rigid_poses[1].position[2], abs=2e-3)


def test_groups_become_masks() -> None:
    balls = tuple(
        RigidBodyDescription(
            name=name, shape=Shape(sphere=0.01), mass=0.01, pose=Placement(translation=(0.1 * k, 0.0, 0.0))
        )
        for k, name in enumerate("abc")
    )
    groups = {"a": ("left",), "b": ("left", "right"), "c": ("right",)}
    scene = SceneDescription(
        name="balls",
        rigid_bodies=balls,
        collisions=tuple(CollisionDescription(name=n, body=n, groups=g) for n, g in groups.items()),
    )
    geoms = {each.get("name"): each for each in ElementTree.fromstring(export_mjcf(scene).text).iter("geom")}

    def meet(one: str, other: str) -> bool:
        a, b = geoms[one], geoms[other]
        return bool(int(a.get("contype")) & int(b.get("conaffinity")))

    assert meet("a", "c")
    assert meet("c", "a")
    assert not meet("a", "b")
    assert not meet("c", "b")


def test_a_scene_comes_back_as_it_was(tmp_path: Path) -> None:
    """Out and in: the same nodes, cells, masses, pins, joints, cables; and the same motion."""
    pytest.importorskip("mujoco")
    cable = JointDescription(
        name="cable",
        kind="cable",
        limits=JointLimits(lower=0.0, upper=2.0),
        actuator=CableDescription(
            body="beam",
            points=((0.02, 0.0, SIDE), (LENGTH, 0.0, SIDE)),
            pull_point=(-0.1, 0.0, SIDE),
            control="force",
        ),
    )
    ball = RigidBodyDescription(
        name="ball", shape=Shape(sphere=0.01), mass=0.01, pose=Placement(translation=(0.3, 0.0, 0.02))
    )
    scene = beam_scene(joints=(cable,), rigid_bodies=(ball,))
    file = tmp_path / "model.xml"
    file.write_text(export_mjcf(scene).text)
    made = import_mjcf(file, LAW)
    back = load_scene(write_imported(made, tmp_path / "to", "model.xml")).scene
    (body,), (again,) = made.scene.bodies, back.joints
    np.testing.assert_allclose(body.mesh.points, BEAM.mesh.points, atol=1e-12)
    assert np.array_equal(np.sort(body.mesh.tets), np.sort(BEAM.mesh.tets))
    assert body.density == pytest.approx(1000.0)
    assert (again.kind, again.limits.upper) == ("cable", 2.0)
    np.testing.assert_allclose(again.actuator.points, cable.actuator.points)
    assert again.actuator.pull_point == pytest.approx(cable.actuator.pull_point)
    runs = [Simulation(each, backend="scipy") for each in (scene, back)]
    for each in runs:
        each.command([1.0])
        for _ in range(10):
            each.step()
    np.testing.assert_allclose(runs[0].positions, runs[1].positions, atol=1e-9)
    np.testing.assert_allclose(runs[0].rigid_poses[0].position, runs[1].rigid_poses[0].position, atol=1e-9)


def test_what_mujoco_has_nothing_for_is_refused() -> None:
    rod = BodyDescription(
        name="rod",
        rod=RodDescription(
            centreline=((0.0, 0.0, 0.0), (0.1, 0.0, 0.0)),
            section=RodSectionDescription(shape="ellipse", size=(0.002, 0.002)),
        ),
        material=MaterialDescription(young_modulus=1e6, poisson_ratio=0.3),
        density=1000.0,
    )
    with pytest.raises(MjcfError, match="body rod is a rod"):
        export_mjcf(SceneDescription(name="rods", bodies=(rod,)))
    with pytest.raises(MjcfError, match="has cells tet10, MuJoCo only tet4; set `order: 1`"):
        export_mjcf(beam_scene(bodies=(replace(BEAM, order=2),)))


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("pneu_step_2", "joint air: kind chamber: MuJoCo has nothing for it"),
        ("pneu_step_4", "layers and fibres are not in the model"),
        (
            "cable_finger",
            "body finger: law corotational: MuJoCo's saint_venant_kirchhoff is the same at small strain",
        ),
        ("cable_finger", "cable cable: its points sit on the nearest nodes in the model"),
        ("tripod", "joint servo_0: follows its command with 1000 N·m/rad"),
        ("sensed_finger", "is not in the model"),
    ],
)
def test_what_the_model_lacks_is_told(name: str, line: str) -> None:
    scene = load_scene(name).scene
    scene = replace(scene, bodies=tuple(replace(each, order=1) for each in scene.bodies))
    assert any(line in told for told in export_mjcf(scene).remarks), export_mjcf(scene).remarks


@pytest.mark.parametrize("name", ["tripod", "cable_finger", "gripper_step_4", "tripod_ball", "objects"])
def test_shipped_scenes_compile_in_mujoco_with_their_nodes(name: str) -> None:
    pytest.importorskip("mujoco")
    scene = load_scene(name).scene
    run = MujocoRun(export_mjcf(scene).text)
    np.testing.assert_allclose(run.points(), Simulation(scene, backend="scipy").model.rest, atol=1e-12)
    for _ in range(3):
        run.advance()
    assert np.isfinite(run.points()).all()
