"""What servos must hold: weight times lever arm, whatever the drive; and symmetry of a symmetric robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from closed_forms import torsion_pendulum_angle, weight_torque
from small_scenes import GRAVITY, body, scene, slab

from softsim_core import Simulation, load_scene
from softsim_core.base import Backend, Placement
from softsim_core.physics.dynamics import solve_static
from softsim_core.physics.mechanics import Control, rotation_exp, rotation_log, rotation_of
from softsim_core.physics.mesh import box_mesh
from softsim_core.scene import JointDescription, SceneDescription
from softsim_core.simulation import SPEED

MASS, LENGTH = 0.05, 0.1
AXIS = (0.0, -1.0, 0.0)  # a positive angle lifts the tip


def arm(angle: float, stiffness: float | None, young_modulus: float = 1e9) -> SceneDescription:
    """A block along x on a hinge at the origin, built at `angle`; mass spread over its nodes evenly."""
    mesh = box_mesh((LENGTH, 0.02, 0.02), (5, 1, 1), (0.0, -0.01, -0.01))
    turned = replace(mesh, points=mesh.points @ rotation_exp(angle * np.array(AXIS)).T)
    # the region is chosen in the hinge's base frame, which is turned with the block
    base = Placement(rotation_deg=(0.0, -np.degrees(angle), 0.0))
    hinge = JointDescription(name="hinge", base=base, axis=AXIS, stiffness=stiffness, inertia=1e-6)
    region = slab("root", "hinge", 0.0, relative_to="hinge")
    block = body(turned, young_modulus=young_modulus, total_mass=MASS)
    return scene(block, joints=(hinge,), attachments=(region,), rayleigh_stiffness=1e-3, rayleigh_mass=5.0)


def settled(sim: Simulation, steps: int = 2000) -> Simulation:
    for _ in range(steps):
        sim.step()
        if np.abs(sim.velocities).max() < 1e-12:
            break
    return sim


@pytest.mark.parametrize("angle", [0.0, 0.7, -1.2, np.pi / 2])
@pytest.mark.parametrize("stiffness", [None, 1e4])
def test_holding_torque_is_weight_times_lever_arm(
    angle: float, stiffness: float | None, backend: Backend
) -> None:
    sim = settled(Simulation(arm(angle, stiffness), backend=backend))
    expected = weight_torque(MASS, GRAVITY, LENGTH / 2.0, angle)
    assert sim.joint_efforts[0] == pytest.approx(expected, abs=2e-3 * MASS * GRAVITY * LENGTH)


@pytest.mark.parametrize("stiffness", [None, 0.5])
def test_holding_torque_of_a_soft_arm_counts_its_sag(stiffness: float | None, backend: Backend) -> None:
    """The lever arms are those of the bent arm, exactly."""
    sim = settled(Simulation(arm(0.2, stiffness, young_modulus=1e5), backend=backend))
    lever = np.cross(sim.positions, [0.0, 0.0, -GRAVITY]) @ AXIS
    assert sim.joint_efforts[0] == pytest.approx(-(sim.model.mass * lever).sum(), rel=1e-9)
    if stiffness is not None:
        given = torsion_pendulum_angle(stiffness, sim.joint_efforts[0])
        assert -sim.joint_positions[0] == pytest.approx(given, rel=1e-12)


@pytest.mark.parametrize("stiffness", [None, 200.0])
def test_holding_force_of_a_lift_is_the_weight(stiffness: float | None, backend: Backend) -> None:
    lift = JointDescription(
        name="lift", kind="prismatic", axis=(0.0, 0.6, 0.8), stiffness=stiffness, inertia=0.001
    )
    block = body(box_mesh((LENGTH, 0.02, 0.02), (5, 1, 1)), young_modulus=1e5, total_mass=MASS)
    sim = Simulation(
        scene(block, joints=(lift,), attachments=(slab("root", "lift", 0.0),), rayleigh_mass=5.0),
        backend=backend,
    )
    sim.command([0.01])
    settled(sim)
    weight = 0.8 * MASS * GRAVITY  # its part along the axis
    assert sim.joint_efforts[0] == pytest.approx(weight, rel=1e-9)
    reached = 0.01 - (0.0 if stiffness is None else weight / stiffness)
    assert sim.joint_positions[0] == pytest.approx(reached, rel=1e-9)


def test_a_prescribed_joint_is_where_it_is_commanded(backend: Backend) -> None:
    sim = Simulation(arm(0.0, None), backend=backend)
    rng, before = np.random.default_rng(0), 0.0
    for _ in range(20):
        target = rng.uniform(-6.0, 6.0)  # full turns too
        sim.command([target])
        sim.step()
        assert sim.joint_positions[0] == target
        assert sim.joint_velocities[0] * sim.dt == pytest.approx(target - before, abs=1e-12)
        before = target


def test_prescribed_and_stiff_compliant_servos_hold_the_same_on_the_tripod() -> None:
    prescribed = load_scene("tripod")
    compliant = prescribed.with_scene(
        joints=tuple(replace(joint, stiffness=1e4) for joint in prescribed.joints)
    )
    efforts = []
    for robot in (prescribed, compliant):
        sim = Simulation(robot, backend="scipy")
        control = Control(np.array([-1.4, -1.1, -0.9]), sim.forces, 0.035)
        efforts.append(
            solve_static(sim.model, sim.model.rest_state(), control, sim.parameters).state.joint_efforts
        )
    assert np.abs(efforts[0]).max() > 0.02
    np.testing.assert_allclose(efforts[1], efforts[0], rtol=1e-3, atol=1e-5)


def test_base_shift_carries_the_region_along(backend: Backend) -> None:
    sim = settled(Simulation(arm(0.0, None), backend=backend))
    before, effort = sim.positions, sim.joint_efforts
    sim.base_shift = 0.03
    sim.step()
    assert sim.base_shift == 0.03
    frames = sim.frames()
    np.testing.assert_allclose(frames["hinge"].position, [0.03, 0.0, 0.0])
    np.testing.assert_allclose(frames["hinge_horn"].position, [0.03, 0.0, 0.0])
    root = np.flatnonzero(sim.model.region_of_node >= 0)
    moved = sim.positions[root] - before[root]
    np.testing.assert_allclose(moved, np.broadcast_to([0.03, 0.0, 0.0], moved.shape), atol=1e-15)
    settled(sim)
    np.testing.assert_allclose(
        sim.positions - before, np.broadcast_to([0.03, 0.0, 0.0], before.shape), atol=1e-9
    )
    np.testing.assert_allclose(sim.joint_efforts, effort, rtol=1e-6)


def test_a_moved_base_carries_the_whole_arm_along(backend: Backend) -> None:
    sim = settled(Simulation(arm(0.0, None), backend=backend))
    before, effort = sim.positions, sim.joint_efforts
    way = np.array([0.01, -0.004, 0.006])
    sim.move_base("hinge", way)
    sim.step()
    np.testing.assert_allclose(np.linalg.norm(sim.frames()["hinge"].position), SPEED * sim.dt)
    root = np.flatnonzero(sim.model.region_of_node >= 0)
    for _ in range(round(np.linalg.norm(way) / (SPEED * sim.dt)) + 1):
        sim.step()
        origin = sim.frames()["hinge"].position
        np.testing.assert_allclose(
            sim.positions[root] - before[root], origin + 0.0 * before[root], atol=1e-12
        )
    np.testing.assert_array_equal(sim.frames()["hinge"].position, way)
    settled(sim)
    np.testing.assert_allclose(sim.positions - before, way + 0.0 * before, atol=1e-9)
    np.testing.assert_allclose(sim.joint_efforts, effort, rtol=1e-6)


@pytest.mark.parametrize("robot", ["tripod", pytest.param("tripod_mid", marks=pytest.mark.slow)])
@pytest.mark.parametrize("pose", ["rest", "start", "mid", "high"])
def test_symmetric_poses_of_the_symmetric_robot(robot: str, pose: str) -> None:
    """Equal angles: the effector stays on the axis, upright, and all servos hold the same torque."""
    sim = Simulation(load_scene(robot), backend="scipy")
    assert sim.model.law(0).name == "corotational"
    command = np.zeros(3) if pose == "rest" else np.array(sim.robot.poses[pose])
    control = Control(command, sim.forces, 0.0 if pose == "rest" else 0.035)
    state = solve_static(sim.model, sim.model.rest_state(), control, sim.parameters).state
    assert np.abs(state.frame_positions[0, :2]).max() < 1e-9
    assert np.linalg.norm(rotation_log(state.frame_rotations[0])) < 1e-9
    np.testing.assert_allclose(state.joint_efforts, state.joint_efforts.mean(), rtol=1e-7)
    if pose != "rest":
        assert state.frame_positions[0, 2] != pytest.approx(0.030, abs=1e-3)


def test_the_start_animation_stays_symmetric(backend: Backend) -> None:
    sim = Simulation(load_scene("tripod"), backend=backend)
    sim.start_animation()
    for _ in range(60):
        sim.step()
        pose = sim.effector_pose
        assert pose is not None
        assert np.abs(pose.position[:2]).max() < 1e-9
        assert np.linalg.norm(rotation_log(rotation_of(pose.quaternion_xyzw))) < 1e-8
        np.testing.assert_allclose(sim.joint_efforts, sim.joint_efforts.mean(), rtol=1e-6, atol=1e-9)
