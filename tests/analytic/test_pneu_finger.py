"""The pneumatic finger: its mesh, its bending, inverse control, and random days with soft rubber."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softsim_core import InverseController, Simulation, load_scene, rotation_of
from softsim_core.base import MeshError, Placement
from softsim_core.physics.mesh import Shape, cavities, check_tets, read_tets
from softsim_core.robots import pneu_finger, pneu_finger_mesh
from softsim_core.scene import CollisionDescription, MaterialDescription, RigidBodyDescription

MESH = Path(__file__).resolve().parents[2] / "configs" / "meshes" / "pneu_finger.vtk"


@pytest.mark.parametrize("chambers", [1, 2, 5, pneu_finger_mesh.CHAMBERS])
def test_the_mesh_is_a_bar_around_its_chambers(chambers: int) -> None:
    mesh = pneu_finger(chambers)
    report = check_tets(mesh)
    assert not report.warnings
    hollow = (
        chambers
        * 0.008
        * (pneu_finger_mesh.WIDTH - 2 * pneu_finger_mesh.SIDE)
        * (pneu_finger_mesh.HEIGHT - 2 * pneu_finger_mesh.SIDE)
    )
    assert report.volume == pytest.approx(
        pneu_finger_mesh.length_of(chambers) * pneu_finger_mesh.WIDTH * pneu_finger_mesh.HEIGHT - hollow
    )
    assert len(cavities(mesh)) == chambers


def test_a_finger_without_chambers_is_refused() -> None:
    with pytest.raises(MeshError, match="a finger has at least one chamber, not 0"):
        pneu_finger(0)


def test_the_shipped_mesh_is_the_generated_one(tmp_path: Path) -> None:
    assert pneu_finger_mesh.main(["--out", str(tmp_path)]) == 0
    for name in ("pneu_finger.vtk", "pneu_finger.stl"):
        assert (tmp_path / name).read_bytes() == MESH.with_name(name).read_bytes()
    np.testing.assert_allclose(read_tets(MESH).points, pneu_finger().points, atol=1e-12)


def bend(simulation: Simulation) -> float:
    """How far the tip has turned towards the paper, in [rad]."""
    pose = simulation.effector_pose
    assert pose is not None
    rotation = rotation_of(pose.quaternion_xyzw)
    return float(np.arctan2(-rotation[2, 0], rotation[0, 0]))


@pytest.mark.slow
def test_air_bends_it_towards_the_paper_and_paper_and_thread_do_not_stretch() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        simulation = Simulation(load_scene("pneu_finger"))
    rest, bends = simulation.model.rest, []
    for growth in (0.0, 3e-7, 6e-7, 9e-7):
        simulation.settle([growth])
        bends.append(bend(simulation))
    assert 5e4 < simulation.joint_efforts[0] < 6e4
    assert np.all(np.diff(bends) > np.radians(15.0))
    side = np.flatnonzero(
        (np.abs(rest[:, 0]) < 1e-9) & (np.abs(np.abs(rest[:, 1]) - pneu_finger_mesh.WIDTH / 2) < 1e-9)
    )
    order = side[np.lexsort((-rest[side, 2], rest[side, 1]))]
    for edge in np.split(order, 2):  # along the paper's two long edges
        steps = [np.diff(x[edge], axis=0) for x in (rest, simulation.positions)]
        lengths = [np.linalg.norm(each, axis=1).sum() for each in steps]
        assert lengths[1] == pytest.approx(lengths[0], rel=5e-3)


@pytest.mark.slow
@pytest.mark.parametrize("growth", [9e-7])
def test_a_reachable_place_of_the_tip_is_reached(growth: float) -> None:
    pytest.importorskip("daqp")
    robot = load_scene("pneu_finger")
    there = Simulation(robot)
    there.settle([growth])
    goal = there.effector_pose
    assert goal is not None
    controller = InverseController(robot)
    controller.start([4e-7], 0.0)
    controller.set_goal(goal)
    for _ in range(400):
        report = controller.tick()
        if report.status == "reached":
            break
    assert report.residual_m < 2e-4
    assert report.command[0] == pytest.approx(growth, rel=0.1)  # it swings by while it moves


def random_days(steps: int, seed: int) -> int:
    """A finger of Ecoflex jumps between volumes beside a post; returns how often it was seen to touch."""
    robot = load_scene("pneu_finger")
    (body,) = robot.scene.bodies
    soft = replace(body, material=MaterialDescription(preset="Ecoflex 00-30"))
    post = RigidBodyDescription(
        name="post",
        shape=Shape(box=(0.01, 0.04, 0.05)),
        pose=Placement(translation=(-0.028, 0.004, -0.07), rotation_deg=(11.0, 17.0, 23.0)),
    )
    surfaces = tuple(CollisionDescription(name=name, body=name) for name in ("finger", "post"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the table's stiffness
        simulation = Simulation(robot.with_scene(bodies=(soft,), rigid_bodies=(post,), collisions=surfaces))
    rng, touched = np.random.default_rng(seed), 0
    for step in range(steps):
        if step % 10 == 0:
            simulation.command([rng.uniform(-3e-7, 1.2e-6)])
        simulation.step()
        touched += bool(len(simulation.contacts.points)) if step % 10 == 9 else 0
    assert np.isfinite(simulation.positions).all()
    assert np.abs(simulation.positions).max() < 0.15
    return touched


@pytest.mark.slow
def test_random_volumes_in_contact_do_not_break_soft_rubber() -> None:
    assert random_days(120, 4) > 3


@pytest.mark.exhaustive
def test_ten_thousand_random_steps_in_contact() -> None:
    assert random_days(10_000, 5) > 100
