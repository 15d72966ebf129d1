"""Hinges on hinges carry silicone and cables, as an arm does: places, forces, tangents, implementations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_scenes import body, scene, slab

from softsim_core import CableDescription, Simulation
from softsim_core.base import Array, Backend, Placement
from softsim_core.physics.dynamics import reduced_stiffness
from softsim_core.physics.mechanics import JointLimits, rotation_euler, rotation_exp
from softsim_core.physics.mesh import box_mesh
from softsim_core.scene import JointDescription, SceneDescription

SEED = np.random.default_rng(11)
KINDS = ("revolute", "revolute", "prismatic", "revolute", "revolute")
AXES = SEED.normal(size=(len(KINDS), 3))
AXES /= np.linalg.norm(AXES, axis=1)[:, None]
ORIGINS = np.array([-0.3, 0.1, -0.2]) + SEED.uniform(0.0, 0.1, (len(KINDS), 3)).cumsum(axis=0)
TURNS = SEED.uniform(-90.0, 90.0, (len(KINDS), 3))
REST = np.array([0.2, -0.4, 0.03, 0.5, -0.3])
COMMAND = REST + np.array([0.15, -0.2, 0.01, 0.1, 0.25])


def arm(springs: bool = True) -> SceneDescription:
    """Four tilted hinges and a slide, not at zero at rest, hold a bar; a cable from the last one pulls it.

    The fourth hinge is springy if there are `springs`.
    """
    joints = tuple(
        JointDescription(
            name=f"joint_{k}",
            kind=kind,
            axis=tuple(AXES[k].tolist()),
            base=Placement(translation=tuple(ORIGINS[k].tolist()), rotation_deg=tuple(TURNS[k].tolist())),
            parent=f"joint_{k - 1}" if k else None,
            rest=float(REST[k]),
            limits=JointLimits(speed=2.0 if kind == "revolute" else 0.1),
            stiffness=0.5 if springs and k == 3 else None,
            inertia=1e-4 if springs and k == 3 else 0.0,
        )
        for k, kind in enumerate(KINDS)
    )
    bar = body(box_mesh((0.06, 0.01, 0.01), (6, 1, 1), (0.0, -0.005, -0.005)), "bar", total_mass=0.006)
    cable = CableDescription(
        body="bar",
        points=((0.02, 0.003, 0.005), (0.05, 0.004, 0.005)),
        pull_point=(-0.02, 0.0, 0.02),
        pull_on="joint_4",
    )
    pulled = JointDescription(name="cable", kind="cable", actuator=cable, limits=JointLimits(0.0, 0.01, 0.05))
    return replace(
        scene(bar, joints=(*joints, pulled), attachments=(slab("root", "joint_4", 0.0, "bar"),)),
        gravity=(1.0, -3.0, -9.0),
    )


def frame_of_last(positions: Array) -> tuple[Array, Array]:
    """Where what stands in the world at rest goes (x = p + R X), by a product of the joints' own motions.

    Each joint moves all outside it about its axis where that stands at rest, the outermost joint last.
    """
    place, turn = np.zeros(3), np.eye(3)
    for k in reversed(range(len(KINDS))):
        axis = rotation_euler(np.radians(TURNS[k])) @ AXES[k]
        moved = positions[k] - REST[k]
        if KINDS[k] == "revolute":
            about = rotation_exp(moved * axis)
            place, turn = about @ (place - ORIGINS[k]) + ORIGINS[k], about @ turn
        else:
            place = place + moved * axis
    return place, turn


def run(backend: Backend, steps: int = 40) -> Simulation:
    simulation = Simulation(arm(), backend)
    simulation.command([*COMMAND, 0.003])
    for _ in range(steps):
        simulation.step()
    return simulation


def test_the_body_hangs_where_the_product_of_motions_says(backend: Backend) -> None:
    simulation = run(backend)
    place, turn = frame_of_last(simulation.joint_positions)
    held = simulation.model.regions[0].nodes
    expected = place + simulation.model.rest[held] @ turn.T
    assert np.abs(simulation.positions[held] - expected).max() < 1e-12
    pulled_at = place + turn @ np.array([-0.02, 0.0, 0.02])
    assert np.abs(simulation.actuators[0].points[0] - pulled_at).max() < 1e-12


def test_nodes_on_the_chain_have_the_velocity_that_moves_them(backend: Backend) -> None:
    simulation = run(backend, 4)
    held, rates = simulation.model.regions[0].nodes, simulation._state.reduced_velocities
    ends = []
    for sign in (1.0, -1.0):
        place, turn = frame_of_last(simulation.joint_positions + sign * 1e-6 * rates)
        ends.append(place + simulation.model.rest[held] @ turn.T)
    velocities = simulation._state.velocities[held]
    assert np.abs(velocities).max() > 0.3
    assert velocities == pytest.approx((ends[0] - ends[1]) / 2e-6, abs=1e-8)


def test_both_implementations_agree() -> None:
    pytest.importorskip("numba")
    fast, readable = run("numba"), run("scipy")
    assert np.abs(fast.positions - readable.positions).max() < 1e-9
    assert fast.joint_efforts == pytest.approx(readable.joint_efforts, abs=1e-6)


@pytest.mark.slow
def test_what_the_joints_hold_changes_as_the_static_tangent_says(backend: Backend) -> None:
    simulation = Simulation(arm(springs=False), backend)
    base = simulation.settle([*COMMAND, 0.001])
    stiffness = reduced_stiffness(
        simulation._stepper, base.state, simulation.parameters, np.zeros_like(simulation.positions)
    )
    step = 1e-5
    for k in range(len(KINDS)):
        ahead, behind = (
            simulation.equilibrium([*(COMMAND + sign * step * np.eye(len(KINDS))[k]), 0.001])
            for sign in (1.0, -1.0)
        )
        change = (ahead.state.joint_efforts - behind.state.joint_efforts) / (2.0 * step)
        assert stiffness[:5, k] == pytest.approx(change[:5], rel=1e-4, abs=1e-5)
