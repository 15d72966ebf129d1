"""IMUs: on a turning horn, on what flies, and on a frame that is shaken, against kinematics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from contact_scenes import loose, touching
from scipy.spatial.transform import Rotation, Slerp
from small_scenes import GRAVITY, machine, scene, shaken

from softsim_core import Simulation
from softsim_core.base import Placement
from softsim_core.physics.mechanics import JointLimits
from softsim_core.physics.mesh import Shape
from softsim_core.physics.sensing import ImuDescription
from softsim_core.scene import JointDescription

DOWN = np.array([0.0, 0.0, -GRAVITY])


def placed(rng: np.random.Generator, reach: float) -> Placement:
    """Somewhere within `reach` [m] of the origin, turned at random."""
    shift, turn = rng.uniform(-reach, reach, 3), rng.uniform(-180.0, 180.0, 3)
    return Placement(translation=tuple(shift.tolist()), rotation_deg=tuple(turn.tolist()))


def parts(placement: Placement) -> tuple[np.ndarray, Rotation]:
    """Shift and turn of a placement."""
    return np.array(placement.translation), Rotation.from_euler("xyz", placement.rotation_deg, degrees=True)


@pytest.mark.parametrize("seed", range(4))
def test_an_imu_on_a_turning_horn(seed: int) -> None:
    """A horn that turns evenly: gravity turns in the unit's axes, and r omega^2 points to the axis."""
    rng = np.random.default_rng(seed)
    axis, base, pose = rng.normal(size=3), placed(rng, 0.1), placed(rng, 0.05)
    axis /= np.linalg.norm(axis)
    speed = rng.uniform(2.0, 8.0)
    joint = JointDescription(
        name="servo", base=base, axis=tuple(axis.tolist()), limits=JointLimits(-50.0, 50.0, speed)
    )
    imu = ImuDescription(name="imu", on="servo", pose=pose)
    simulation = Simulation(scene(joints=(joint,), sensors=(imu,), dt=0.01), backend="scipy")
    np.testing.assert_allclose(  # before any step: gravity alone
        simulation.sensors["imu"].value[:3], -(parts(base)[1] * parts(pose)[1]).inv().apply(DOWN), atol=1e-12
    )
    simulation.command([50.0])
    for _ in range(40):
        simulation.step()
    told = simulation.sensors["imu"].value
    middle = simulation.joint_positions[0] - 0.5 * speed * simulation.dt
    horn = parts(base)[1] * Rotation.from_rotvec(middle * axis)
    lever, turned = parts(pose)
    to_axis = axis * (axis @ lever) - lever
    expected = turned.inv().apply(speed**2 * to_axis - horn.inv().apply(DOWN))
    np.testing.assert_allclose(told[:3], expected, rtol=0.0, atol=1e-3 * np.linalg.norm(expected))
    np.testing.assert_allclose(told[3:], turned.inv().apply(speed * axis), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("seed", range(2))
def test_an_imu_in_the_air_feels_its_turning_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    spin, pose = rng.normal(size=3) * 3.0, placed(rng, 0.02)
    thrown = loose(
        "ball",
        Shape(sphere=0.03),
        1.0,
        velocity=(0.3, -0.2, 2.0),
        angular_velocity=tuple(spin.tolist()),
    )
    sensors = (ImuDescription(name="middle", on="ball"), ImuDescription(name="aside", on="ball", pose=pose))
    simulation = Simulation(replace(touching(thrown, backend="scipy"), dt=0.002, sensors=sensors))
    for _ in range(20):
        simulation.step()
    np.testing.assert_allclose(simulation.sensors["middle"].value[:3], 0.0, atol=1e-9)
    lever, turned = parts(pose)
    body = Rotation.from_quat(simulation.rigid_poses[0].quaternion_xyzw).inv().apply(spin)
    expected = turned.inv().apply(np.cross(body, np.cross(body, lever)))
    told = simulation.sensors["aside"].value
    np.testing.assert_allclose(told[:3], expected, atol=1e-2 * np.linalg.norm(expected))
    np.testing.assert_allclose(told[3:], turned.inv().apply(body), rtol=1e-6, atol=1e-9)


def test_an_imu_on_a_shaken_frame_is_the_second_difference_of_its_way() -> None:
    sensors = (ImuDescription(name="imu", on="middle"), ImuDescription(name="wall", on="held"))
    simulation = Simulation(machine(sensors=sensors), backend="scipy")
    shaken(simulation, 30, seed=3)
    poses = []
    for _ in range(3):
        poses.append(simulation.frames()["middle"])
        simulation.step()
    poses = [*poses[1:], simulation.frames()["middle"]]
    ways = np.diff([pose.position for pose in poses], axis=0)
    acceleration = (ways[1] - ways[0]) / simulation.dt**2
    turns = Rotation.from_quat([pose.quaternion_xyzw for pose in poses[1:]])
    middle = Slerp([0.0, 1.0], turns)(0.5)
    told = simulation.sensors["imu"].value
    np.testing.assert_allclose(told[:3], middle.inv().apply(acceleration - DOWN), rtol=1e-6, atol=1e-6)
    rate = (turns[1] * turns[0].inv()).as_rotvec() / simulation.dt
    np.testing.assert_allclose(told[3:], turns[1].inv().apply(rate), rtol=1e-6, atol=1e-9)
    np.testing.assert_array_equal(simulation.sensors["wall"].value, [*-DOWN, 0.0, 0.0, 0.0])
