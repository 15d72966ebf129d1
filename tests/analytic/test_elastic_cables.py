"""Cables that stretch, against springs in series: bars that they pull and bend, at rest and in motion."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from cable_scenes import bent_bar, cable_joint
from numpy.testing import assert_allclose
from small_scenes import body, scene, slab

from softsim_core import Simulation
from softsim_core.base import Backend, FieldError, Placement, SceneError
from softsim_core.control.inverse import analytic_sensitivity, sampled_sensitivity
from softsim_core.physics.mechanics import JointLimits
from softsim_core.physics.mesh import box_mesh
from softsim_core.scene import (
    AttachmentDescription,
    BodyDescription,
    JointDescription,
    MaterialDescription,
    RodDescription,
    RodSectionDescription,
    SceneDescription,
)

BAR = 1e5 * 0.012**2 / 0.1
"""Stiffness of the bar in [N/m]: E A / L."""
AHEAD, BEHIND = (0.25, 0.0, 0.0), (-0.05, 0.0, 0.0)
LONG = 0.15
"""Length of both cables at rest in [m]."""


def pull(name: str, pull_point: tuple[float, float, float] = AHEAD, **fields: Any) -> JointDescription:
    """A cable from a point ahead of the bar, or behind it, to the middle of its end."""
    limits = JointLimits(lower=-0.1, upper=0.1)
    return cable_joint(name, points=((0.1, 0.0, 0.0),), pull_point=pull_point, limits=limits, **fields)


def bar(*cables: JointDescription) -> SceneDescription:
    """A bar that does not contract across, held at one end; the other end is a rigid frame."""
    mesh = box_mesh((0.1, 0.012, 0.012), (6, 2, 2), (0.0, -0.006, -0.006))
    end = slab("end", "free", 0.1, "bar", frame=Placement(translation=(0.1, 0.0, 0.0)))
    return scene(
        body(mesh, "bar", 1e5, 0.0, 0.02),
        joints=cables,
        attachments=(slab("held", "world", 0.0, "bar"), end),
        effector="end",
        gravity=(0.0, 0.0, 0.0),
        rayleigh_stiffness=0.02,
    )


def stretched(sim: Simulation) -> float:
    """How far the end of the bar is from its place in [m]."""
    pose = sim.effector_pose
    assert pose is not None
    return float(pose.position[0]) - 0.1


@pytest.mark.parametrize("seed", range(6))
def test_a_cable_and_a_bar_are_springs_in_series(seed: int) -> None:
    rng = np.random.default_rng(seed)
    stiffness, compliance = 10.0 ** rng.uniform(0.0, 3.0), 10.0 ** rng.uniform(-4.0, -2.0)
    pretension, command = rng.uniform(0.0, 0.5), rng.uniform(0.0, 0.004)
    stretch = compliance + LONG / stiffness  # in m/N
    sim = Simulation(bar(pull("c", axial_stiffness=stiffness, compliance=compliance, pretension=pretension)))
    sim.settle([command])
    wanted = (command + stretch * pretension) / (1.0 + stretch * BAR)
    assert stretched(sim) == pytest.approx(wanted, rel=1e-6)
    assert sim.joint_positions[0] == pytest.approx(wanted, rel=1e-6)
    assert sim.joint_efforts[0] == pytest.approx(BAR * wanted, rel=1e-6)


@pytest.mark.numba
def test_opposed_and_parallel_cables_share_the_load_by_their_stiffness(backend: Backend) -> None:
    """Two pull on the end from ahead and one from behind, all with different stiffness and pretension."""
    stretch, pretension = np.array([0.002, 0.006, 0.003]), np.array([0.5, 0.2, 0.9])
    ahead = [pull(f"c{k}", compliance=stretch[k], pretension=pretension[k]) for k in range(2)]
    behind = pull("c2", BEHIND, axial_stiffness=LONG / stretch[2], pretension=pretension[2])
    command, side = np.array([0.002, 0.001, 0.0005]), np.array([1.0, 1.0, -1.0])
    moved = (side @ (pretension + command / stretch)) / (BAR + (1.0 / stretch).sum())
    tension = pretension + (command - side * moved) / stretch
    assert (tension > 0.0).all()
    sim = Simulation(bar(*ahead, behind), backend)
    sim.command(command)
    for _ in range(400):
        sim.step()
    assert stretched(sim) == pytest.approx(moved, rel=1e-4)
    assert_allclose(sim.joint_efforts, tension, rtol=1e-4)
    sim.settle(command)
    assert_allclose(sim.joint_efforts, tension, rtol=1e-6)


def test_a_cable_gets_taut_without_a_jump_and_the_motor_gives_what_the_springs_take() -> None:
    compliance, commands = 0.004, np.linspace(-0.003, 0.003, 61)
    sim, tensions, moved = Simulation(bar(pull("c", compliance=compliance))), [], []
    for command in commands:
        sim.settle([command])
        tensions.append(float(sim.joint_efforts[0]))
        moved.append(stretched(sim))
    tension = np.array(tensions)
    assert not tension[:31].any()  # slack up to the command 0
    steepest = (commands[1] - commands[0]) / (compliance + 1.0 / BAR)
    assert np.diff(tension).max() == pytest.approx(steepest, rel=1e-5)
    work = np.concatenate([[0.0], np.cumsum(0.5 * (tension[1:] + tension[:-1]) * np.diff(commands))])
    taken = 0.5 * compliance * tension**2 + 0.5 * BAR * np.array(moved) ** 2
    assert np.abs(work - taken).max() < 1e-5 * work.max()


@pytest.mark.numba
def test_a_bent_bar_of_elastic_cables_comes_to_its_equilibrium(backend: Backend) -> None:
    """The same shape as under the tension alone; what the cable stretches is missing in its displacement."""
    scene = bent_bar(cable_joint(axial_stiffness=30.0, pretension=0.1), gravity=(0.0, 0.0, 0.0))
    sim = Simulation(scene, backend)
    sim.command([0.006])
    for _ in range(400):
        sim.step()
    tension, stretch = float(sim.joint_efforts[0]), 0.084 / 30.0
    assert sim.joint_positions[0] == pytest.approx(0.006 - stretch * (tension - 0.1), abs=1e-8)
    rest = sim.equilibrium([0.006])
    assert np.abs(rest.state.positions - sim.positions).max() < 1e-6
    pulled = cable_joint(control="force", limits=JointLimits(lower=0.0, upper=10.0))
    by_force = Simulation(bent_bar(pulled, gravity=(0.0, 0.0, 0.0)))
    assert np.abs(by_force.equilibrium([tension]).state.positions - sim.positions).max() < 1e-6


@pytest.mark.slow
def test_inverse_control_differentiates_elastic_cables() -> None:
    sides = ((0.0, 0.004, 40.0), (0.004, -0.003, 90.0), (-0.004, -0.003, 20.0))
    cables = [
        cable_joint(
            f"c{k}", points=tuple((0.001 + 0.014 * i, y, z) for i in range(7)), axial_stiffness=stiffness
        )
        for k, (y, z, stiffness) in enumerate(sides)
    ]
    sim = Simulation(bent_bar(*cables, tip=True, gravity=(0.0, 0.0, -1.0)))
    sim.settle((0.008, 0.006, 0.009))
    assert (sim.joint_efforts > 0.0).all()
    exact, sampled = analytic_sensitivity(sim), sampled_sensitivity(sim, 1e-6)
    for a, b in ((exact.effector, sampled.effector), (exact.effort, sampled.effort)):
        assert np.abs(a - b).max() < 1e-3 * np.abs(b).max()


def test_wrong_numbers_are_refused() -> None:
    with pytest.raises(FieldError, match="axial_stiffness"):
        pull("c", axial_stiffness=0.0)
    with pytest.raises(FieldError, match="compliance"):
        pull("c", compliance=-1.0)
    with pytest.raises(SceneError, match="pretension needs a cable that stretches"):
        pull("c", pretension=1.0)
    with pytest.raises(SceneError, match="the command is the tension; remove pretension"):
        pull("c", compliance=0.001, pretension=1.0, control="force")
    with pytest.raises(FieldError, match="at most max_tension, 2 N"):
        pull("c", compliance=0.001, pretension=3.0, max_tension=2.0)


def arm() -> SceneDescription:
    """A thin rod of steel, 0.18 m long, that three cables bend up to its middle and three up to its tip."""
    centreline = tuple((0.0, 0.0, 0.006 * k) for k in range(31))
    rod = RodDescription(
        centreline=centreline,
        section=RodSectionDescription(shape="ellipse", size=(0.001, 0.001)),
        first_axis=(1.0, 0.0, 0.0),
        elements=30,
    )
    steel = MaterialDescription(law="rod", young_modulus=50e9, poisson_ratio=0.3)
    joints = []
    for k in range(6):
        x, y = 0.0045 * np.cos(2.1 * k), 0.0045 * np.sin(2.1 * k)
        points = tuple((x, y, 0.0105 * i) for i in range(1, 9 if k < 3 else 17))
        joints.append(
            cable_joint(
                f"c{k}", body="rod", points=points, pull_point=(x, y, 0.0), axial_stiffness=800.0,
                limits=JointLimits(lower=-0.02, upper=0.02),
            )
        )  # fmt: skip
    ends = (("base", "world", "start"), ("tip", "free", "end"))
    return scene(
        BodyDescription(name="rod", rod=rod, material=steel, density=7800.0),
        joints=tuple(joints),
        attachments=tuple(
            AttachmentDescription(name=name, body="rod", to=to, end=end)  # type: ignore[arg-type]
            for name, to, end in ends
        ),
        effector="tip",
        gravity=(0.0, 0.0, 0.0),
    )


@pytest.mark.parametrize("seed", range(4))
def test_a_thin_rod_follows_its_cables_in_few_iterations(seed: int) -> None:
    """Its axial stiffness is a million times that of bending; the others of its cables are slack or taut."""
    rng, sim, command = np.random.default_rng(seed), Simulation(arm()), np.full(6, -0.002)
    iterations = []
    for _ in range(24):
        command = np.clip(command + rng.normal(scale=7e-4, size=6), -0.004, 0.003)
        iterations.append(sim.settle(command).iterations)
    assert (sim.joint_efforts >= 0.0).all()
    assert max(iterations) <= 24
