"""Equilibria to which commands lead, found by compiled steps without mass, against Newton's method."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cable_scenes import bent_bar, cable_joint
from small_scenes import body, scene, slab

from softsim_core import Simulation, load_scene
from softsim_core.base import Array, NotConvergedError
from softsim_core.physics.dynamics import StaticSolution, solve_static
from softsim_core.physics.mechanics import Control
from softsim_core.physics.mesh import box_mesh
from softsim_core.scene import JointDescription, MaterialDescription, SceneDescription

pytest.importorskip("numba")


def by_newton(simulation: Simulation, joints: Array) -> StaticSolution:
    """The same equilibrium without compiled steps."""
    return solve_static(
        simulation.model,
        simulation._state,
        Control(joints, simulation.forces, simulation.base_shift),
        simulation.parameters,
        actuators=simulation._actuators,
    )


ROBOTS = ["tripod", "cable_gripper", "emio", "pneu_finger", "tentacle"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOTS)
def test_robots_are_led_to_the_same_equilibria(name: str) -> None:
    """A path of random commands; both ways start from the same state."""
    robot, rng = load_scene(name), np.random.default_rng(len(name))
    simulation = Simulation(robot.robot_alone())
    start = np.array(robot.start_joints)
    simulation.settle(start, robot.start_shift)
    lower, upper = (
        np.array([getattr(joint.limits, side) for joint in robot.joints]) for side in ("lower", "upper")
    )
    far, led = np.clip(rng.uniform(lower, upper), start - 1e5, start + 1e5), 0
    for part in (0.05, 0.12, 0.2, 0.1):
        joints = start + part * (far - start)
        wanted = by_newton(simulation, joints)
        found = simulation.settle(joints)
        size = np.abs(simulation.model.rest).max()
        assert np.abs(found.state.positions - wanted.state.positions).max() < 1e-8 * size
        efforts = np.abs(wanted.state.joint_efforts).max()
        assert found.state.joint_efforts == pytest.approx(wanted.state.joint_efforts, abs=1e-6 * efforts)
        led += found.load_steps == 1
    assert led == 4


def test_cables_with_friction_are_led_to_the_same_equilibria() -> None:
    rng = np.random.default_rng(1)
    simulation = Simulation(bent_bar(cable_joint(friction=0.3, friction_per_length=3.0), tip=True))
    for command in rng.uniform(-0.001, 0.005, 8):
        wanted = by_newton(simulation, np.array([command]))
        found = simulation.settle([command])
        assert np.abs(found.state.positions - wanted.state.positions).max() < 1e-9
        assert found.state.extra["actuators"] == pytest.approx(wanted.state.extra["actuators"], abs=1e-7)


def test_stress_that_relaxes_does_not_count() -> None:
    """Moved fast and then let rest: the stress of the motion is gone."""
    material = MaterialDescription(
        law="stable_neo_hookean", young_modulus=3e5, poisson_ratio=0.4, prony=((0.4, 0.5), (0.2, 5.0))
    )
    bar = bent_bar(cable_joint(), tip=True)
    bar = replace(bar, bodies=(replace(bar.bodies[0], material=material),))
    simulation = Simulation(bar)
    for _ in range(20):
        simulation.command([0.004])
        simulation.step()
    wanted = by_newton(simulation, np.array([0.005]))
    found = simulation.settle([0.005])
    assert found.load_steps == 1
    assert np.abs(found.state.positions - wanted.state.positions).max() < 1e-9


def pressed_column() -> SceneDescription:
    """A slender column that a slide presses along its axis."""
    mesh = box_mesh((0.1, 0.006, 0.006), (14, 2, 2), (0.0, -0.003, -0.003))
    slide = JointDescription(name="slide", kind="prismatic", axis=(-1.0, 0.0, 0.0))
    return scene(
        body(mesh, "column", 1e6, 0.3, 0.003),
        joints=(slide,),
        attachments=(slab("held", "world", 0.0, "column"), slab("top", "slide", 0.1, "column")),
        gravity=(0.0, 0.0, 0.0),
    )


def test_a_column_pressed_beyond_its_buckling_load_is_not_called_stable() -> None:
    """Both ends are clamped: it buckles at a strain of (2 pi)^2 I / (A L^2), 1.2 %."""
    simulation = Simulation(pressed_column())
    assert simulation.settle([0.0008]).load_steps == 1
    before = simulation.positions.copy()
    with pytest.raises(NotConvergedError, match="unstable"):
        simulation.settle([0.004])
    assert np.array_equal(simulation.positions, before)
