"""A simulation that goes on from another one, which has other rigid bodies beside the same robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from softsim_core import Simulation, load_scene
from softsim_core.base import Placement, SceneError, SnapshotError
from softsim_core.physics.mesh import Shape
from softsim_core.scene import CollisionDescription, RigidBodyDescription, RobotDescription

FREE_FALL = (0.0, 0.0, 1.0)
COLD = 1e-7
"""What a contact solve that begins cold may differ by, in [m]; processors differ within it."""


def with_body(robot: RobotDescription, name: str, at: tuple[float, float, float]) -> RobotDescription:
    """The robot and a small sphere that meets everything."""
    body = RigidBodyDescription(
        name=name, shape=Shape(sphere=0.005), mass=0.01, pose=Placement(translation=at)
    )
    return robot.with_scene(
        rigid_bodies=(*robot.scene.rigid_bodies, body),
        collisions=(*robot.scene.collisions, CollisionDescription(name=name, body=name)),
    )


def without_body(robot: RobotDescription, name: str) -> RobotDescription:
    return robot.with_scene(
        rigid_bodies=tuple(each for each in robot.scene.rigid_bodies if each.name != name),
        collisions=tuple(each for each in robot.scene.collisions if each.body != name),
    )


@pytest.fixture(scope="module")
def running() -> Simulation:
    """A Tripod with a ball in motion, tuned and pushed."""
    simulation = Simulation(load_scene("tripod_ball"))
    simulation.set_material("silicone", young_modulus=3.0e5)
    simulation.command([-1.2, -0.9, -1.4])
    simulation.rigid_forces[0, 0] = 0.02
    simulation.forces[5] = (0.0, 0.0, -0.1)
    for _ in range(40):
        simulation.step()
    return simulation


def test_what_both_have_moves_on_as_if_nothing_had_come(running: Simulation) -> None:
    more = Simulation(with_body(running.robot, "pebble", FREE_FALL))
    more.go_on_from(running)
    assert more.time == running.time
    np.testing.assert_array_equal(more.joint_targets, running.joint_targets)
    np.testing.assert_array_equal(more.velocities, running.velocities)
    np.testing.assert_array_equal(more.rigid_forces, [*running.rigid_forces, np.zeros(6)])
    assert more.material("silicone") == running.material("silicone")
    twin = Simulation(running.robot)
    twin.restore(running.snapshot())
    for _ in range(30):
        more.step()
        twin.step()
    np.testing.assert_allclose(more.positions, twin.positions, atol=COLD)
    ball, pebble = more.rigid_poses[0], more.rigid_poses[-1]
    np.testing.assert_allclose(ball.position, twin.rigid_poses[0].position, atol=COLD)
    assert pebble.position[2] == pytest.approx(1.0 - 9.81 * 0.01**2 * 30 * 31 / 2)  # it came 30 steps ago


def test_what_goes_takes_nothing_along(running: Simulation) -> None:
    pebbles = with_body(with_body(running.robot, "first", FREE_FALL), "second", (0.0, 0.0, 2.0))
    many = Simulation(pebbles)
    many.go_on_from(running)
    for _ in range(10):
        many.step()
    fewer = Simulation(without_body(pebbles, "first"))
    fewer.go_on_from(many)
    assert fewer.rigid_names == ("ball", "second")
    np.testing.assert_array_equal(fewer.rigid_velocities, many.rigid_velocities[[0, 2]])
    np.testing.assert_array_equal(fewer.rigid_poses[-1].position, many.rigid_poses[-1].position)
    fewer.step()
    many.step()
    np.testing.assert_allclose(fewer.positions, many.positions, atol=COLD)


def test_what_comes_finds_no_room_where_something_is_now(running: Simulation) -> None:
    """The ball has been carried where nothing was at the start."""
    far = Simulation(running.robot)
    far.restore(running.snapshot())
    far.place_rigid_body("ball", (0.5, 0.0, 0.5), (0.0, 0.0, 0.0, 1.0))
    for at, other in (((0.5, 0.0, 0.51), far), ((0.5, 0.0, 0.5), far)):  # cut, and enclosed
        more = Simulation(with_body(running.robot, "pebble", at))
        before = more.snapshot()
        with pytest.raises(SceneError, match=r"surfaces ball and pebble overlap.* now; move"):
            more.go_on_from(other)
        assert more.snapshot() == before
    more.go_on_from(running)  # there is room where the ball is not


def test_another_robot_is_no_place_to_go_on_from(running: Simulation) -> None:
    scene = running.robot.scene
    other = Simulation(replace(running.robot, scene=replace(scene, dt=0.5 * scene.dt)))
    before = other.snapshot()
    with pytest.raises(SnapshotError, match="not a snapshot of this scene"):
        other.go_on_from(running)
    assert other.snapshot() == before
