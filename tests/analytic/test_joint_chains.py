"""A chain of more than six joints carries a body and a collision surface; both implementations agree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_scenes import body, scene, slab

from softsim_core import Simulation
from softsim_core.base import Backend, Placement
from softsim_core.physics.contact import ContactSettings
from softsim_core.physics.mechanics import JointLimits
from softsim_core.physics.mesh import Shape, box_mesh
from softsim_core.scene import CollisionDescription, JointDescription, RigidBodyDescription, SceneDescription

JOINTS = 8
AXES = np.random.default_rng(4).normal(size=(JOINTS, 3))
AXES /= np.linalg.norm(AXES, axis=1)[:, None]
COMMAND = [0.004, -0.003, 0.002, 0.005, -0.004, 0.003, -0.002, 0.3]
"""In [m], and [rad] of the last joint, which turns."""


def chain() -> SceneDescription:
    """Seven slides one on the other, every third one springy, then a hinge that holds a bar and a paddle.

    A free ball lies on the paddle.
    """
    joints = tuple(
        JointDescription(
            name=f"joint_{k}",
            kind="prismatic" if k < JOINTS - 1 else "revolute",
            axis=tuple(AXES[k].tolist()) if k < JOINTS - 1 else (0.0, 0.0, 1.0),
            parent=f"joint_{k - 1}" if k else None,
            stiffness=400.0 if k % 3 == 1 else None,
            inertia=1e-3 if k % 3 == 1 else 0.0,
            limits=JointLimits(speed=0.02 if k < JOINTS - 1 else 1.0),
        )
        for k in range(JOINTS)
    )
    bar = body(box_mesh((0.06, 0.01, 0.01), (6, 1, 1), (0.0, -0.005, -0.005)), "bar", total_mass=0.006)
    paddle = RigidBodyDescription(
        name="paddle",
        shape=Shape(box=(0.04, 0.04, 0.004)),
        pose=Placement(translation=(0.0, 0.05, 0.0)),
        on=joints[-1].name,
    )
    ball = RigidBodyDescription(
        name="ball", shape=Shape(sphere=0.005), mass=0.002, pose=Placement(translation=(0.0, 0.05, 0.0075))
    )
    return replace(
        scene(bar, joints=joints, attachments=(slab("root", joints[-1].name, 0.0, "bar"),)),
        rigid_bodies=(paddle, ball),
        collisions=tuple(CollisionDescription(name=name, body=name) for name in ("paddle", "ball")),
        contact=ContactSettings(tolerance=1e-12),
    )


def run(backend: Backend, steps: int = 60) -> Simulation:
    simulation = Simulation(chain(), backend)
    simulation.command(COMMAND)
    for _ in range(steps):
        simulation.step()
    return simulation


def test_the_body_stands_where_the_chain_of_frames_says(backend: Backend) -> None:
    simulation = run(backend)
    shift = (AXES[:-1] * simulation.joint_positions[:-1, None]).sum(axis=0)
    angle = simulation.joint_positions[-1]
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    held = simulation.model.regions[0].nodes
    expected = shift + simulation.model.rest[held] @ turn.T
    assert np.abs(simulation.positions[held] - expected).max() < 1e-12
    paddle = simulation.rigid_poses[0].position
    assert np.abs(paddle - shift - turn @ [0.0, 0.05, 0.0]).max() < 1e-12


def test_the_paddle_carries_the_ball(backend: Backend) -> None:
    simulation = run(backend)
    assert len(simulation.contacts.forces) > 0
    paddle, ball = (pose.position for pose in simulation.rigid_poses)
    assert ball[2] - paddle[2] == pytest.approx(0.0075, abs=1e-3)


@pytest.mark.slow
def test_both_implementations_agree() -> None:
    pytest.importorskip("numba")
    fast, readable = run("numba"), run("scipy")
    assert np.abs(fast.positions - readable.positions).max() < 1e-9
    assert np.abs(fast.joint_positions - readable.joint_positions).max() < 1e-9
    assert fast.joint_efforts == pytest.approx(readable.joint_efforts, abs=1e-6)
