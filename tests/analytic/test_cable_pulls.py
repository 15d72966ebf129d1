"""Cables on a soft bar: length, tension, limits; on slides; both steps agree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cable_scenes import bent_bar, cable_joint

from softsim_core import Simulation
from softsim_core.base import Backend
from softsim_core.physics.mechanics import JointLimits
from softsim_core.physics.mesh import box_mesh
from softsim_core.scene import JointDescription, MaterialDescription, SceneDescription

FLOATING = (0.0, 0.0, 0.0)


def settled(scene: SceneDescription, command: list[float], steps: int = 250) -> Simulation:
    """The scene some steps after a command."""
    sim = Simulation(scene)
    sim.command(command)
    for _ in range(steps):
        sim.step()
    return sim


def test_the_cable_is_as_short_as_commanded_and_the_bar_bends_towards_it() -> None:
    sim = settled(bent_bar(gravity=FLOATING), [0.006])
    assert sim.actuators[0].length == pytest.approx(0.084 - 0.006, abs=1e-8)
    assert sim.joint_efforts[0] > 0.1
    assert sim.positions[:, 2].max() > 0.02


def test_a_force_gives_the_shape_of_the_travel_that_has_this_tension() -> None:
    by_travel = settled(bent_bar(gravity=FLOATING), [0.006])
    tension = float(by_travel.joint_efforts[0])
    pulled = cable_joint(control="force", limits=JointLimits(lower=0.0, upper=10.0))
    by_force = settled(bent_bar(pulled, gravity=FLOATING), [tension])
    assert by_force.joint_efforts[0] == pytest.approx(tension, rel=1e-12)
    assert np.abs(by_force.positions - by_travel.positions).max() < 1e-6
    assert by_force.joint_positions[0] == pytest.approx(0.006, abs=1e-6)


@pytest.mark.parametrize("law", ["stable_neo_hookean", "corotational"])
@pytest.mark.parametrize(("damping", "dt"), [(0.0, 0.002), (0.02, 0.002), (0.02, 0.01)])
@pytest.mark.slow
def test_a_bar_pressed_together_by_its_cable_comes_to_rest(law: str, damping: float, dt: float) -> None:
    """The cable's tension is above the load at which the bar alone would buckle, and damping takes energy."""
    scene = bent_bar(dt=dt)
    silicone = MaterialDescription(law=law, young_modulus=1e5, poisson_ratio=0.45)
    bar = replace(
        scene.bodies[0], mesh=box_mesh((0.1, 0.012, 0.012), (5, 1, 1), (0.0, -0.006, -0.006)), order=2,
        material=silicone,
    )  # fmt: skip
    sim = Simulation(replace(scene, bodies=(bar,), solver=replace(scene.solver, rayleigh_stiffness=damping)))
    rest = Simulation(sim.scene).settle([0.012]).state.positions
    sim.command([0.012])
    away = []
    for _ in range(round(3.0 / dt)):
        sim.step()
        away.append(np.abs(sim.positions - rest).max())
    assert sim.joint_efforts[0] > 0.1
    sixth = len(away) // 6
    assert max(away[-sixth:]) < (0.5 if damping else 0.8) * max(away[sixth : 2 * sixth])


def test_a_tension_never_exceeds_its_limit() -> None:
    free = settled(bent_bar(gravity=FLOATING), [0.012])
    cap = 0.4 * float(free.joint_efforts[0])
    sim = Simulation(bent_bar(cable_joint(max_tension=cap), gravity=FLOATING))
    sim.command([0.012])
    for _ in range(250):
        sim.step()
        assert 0.0 <= sim.joint_efforts[0] <= cap * (1.0 + 1e-12)
    assert sim.joint_efforts[0] == pytest.approx(cap, rel=1e-9)
    assert sim.actuators[0].length > 0.084 - 0.012 + 1e-4  # it gives way


def test_a_slack_cable_has_no_tension_and_no_say() -> None:
    sim = settled(bent_bar(gravity=(0.0, 0.0, 3.0)), [0.0])  # gravity shortens its way
    bare = bent_bar(cable_joint(control="force"), gravity=(0.0, 0.0, 3.0))
    assert sim.joint_efforts[0] == 0.0
    assert sim.actuators[0].length < 0.084
    assert np.abs(sim.positions - settled(bare, [0.0]).positions).max() < 1e-12


@pytest.mark.parametrize("command", [0.012, 0.0])  # at its largest tension, and slack
def test_the_position_of_a_cable_is_how_much_shorter_it_is(command: float, backend: Backend) -> None:
    gravity = FLOATING if command else (0.0, 0.0, 3.0)
    sim = Simulation(bent_bar(cable_joint(max_tension=0.3), gravity=gravity), backend)
    sim.command([command])
    for _ in range(150):
        before = sim.actuators[0].length
        sim.step()
    tension, length = sim.joint_efforts[0], sim.actuators[0].length
    assert tension == (0.3 if command else 0.0)
    assert sim.joint_positions[0] == pytest.approx(0.084 - length, abs=1e-15)
    assert sim.joint_velocities[0] * sim.dt == pytest.approx(before - length, abs=1e-15)
    assert abs(sim.joint_positions[0] - command) > 1e-5
    assert sim.joint_targets[0] == command
    still = sim.equilibrium([command]).state
    assert still.joint_efforts[0] == pytest.approx(tension, rel=1e-12)
    assert still.joint_positions[0] == pytest.approx(sim.joint_positions[0], abs=1e-7)


@pytest.mark.slow
def test_both_steps_agree_with_a_cable() -> None:
    pytest.importorskip("numba")
    scene = bent_bar(cable_joint(pull_point=(-0.02, 0.0, 0.006)), tip=True)
    fast, plain = Simulation(scene, "numba"), Simulation(scene, "scipy")
    random = np.random.default_rng(5)
    for step in range(60):
        if step % 10 == 0:
            command = [float(random.uniform(0.0, 0.01))]
            fast.command(command)
            plain.command(command)
        fast.step()
        plain.step()
    assert np.abs(fast.positions - plain.positions).max() < 1e-9
    assert fast.joint_efforts == pytest.approx(plain.joint_efforts, rel=1e-7)


def carriage() -> SceneDescription:
    """A bar whose base and pull point ride on two slides, one on the other."""
    up = JointDescription(name="up", kind="prismatic", axis=(0.0, 0.0, 1.0))
    aside = JointDescription(name="aside", kind="prismatic", axis=(0.0, 1.0, 0.0), parent="up")
    cable = cable_joint(pull_point=(-0.02, 0.0, 0.006), pull_on="aside")
    return bent_bar(cable, up, aside, held="aside", gravity=FLOATING)


def test_slides_carry_base_and_pull_point_and_the_cable_keeps_its_length() -> None:
    here, there = settled(carriage(), [0.004, 0.0, 0.0]), Simulation(carriage())
    there.command([0.004, 0.03, -0.02])
    for _ in range(250):
        there.step()
    shift = np.array([0.0, -0.02, 0.03])
    assert np.abs(there.positions - here.positions - shift).max() < 1e-7
    a, b = here.actuators[0], there.actuators[0]
    assert np.abs(b.points - a.points - shift).max() < 1e-7
    assert b.length == pytest.approx(a.length, abs=1e-9)
    assert b.tension == pytest.approx(a.tension, rel=1e-5)


def test_while_it_slides_the_cable_stays_as_short_as_commanded() -> None:
    sim = settled(carriage(), [0.004, 0.0, 0.0], 150)
    length = sim.actuators[0].length
    for k in range(50):
        sim.command([0.004, 0.0005 * k, 0.0003 * k])
        sim.step()
        assert sim.actuators[0].length == pytest.approx(length, abs=2e-6)
