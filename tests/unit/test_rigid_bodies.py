"""Rigid bodies in a scene: repeated to the byte in contact; both steps agree; who carries what."""

from __future__ import annotations

import numpy as np
import pytest
from small_scenes import body, slab

from softsim_core import Simulation
from softsim_core.base import Placement
from softsim_core.physics.contact import ContactSettings
from softsim_core.physics.mesh import Shape, box_mesh
from softsim_core.scene import (
    CollisionDescription,
    JointDescription,
    RigidBodyDescription,
    SceneDescription,
    SolverSettings,
)


def drop(backend: str = "auto") -> SceneDescription:
    """A ball and a turned box fall on a soft bridge between a wall and a slide."""
    bridge = box_mesh((0.08, 0.04, 0.008), (8, 4, 1), (-0.04, -0.02, -0.008), "bridge")
    ball = RigidBodyDescription(
        name="ball", shape=Shape(sphere=0.008), mass=0.01, pose=Placement(translation=(0.02, 0.0, 0.015))
    )
    box = RigidBodyDescription(
        name="box",
        shape=Shape(box=(0.015, 0.015, 0.015)),
        mass=0.01,
        pose=Placement(translation=(-0.015, 0.003, 0.018), rotation_deg=(10.0, 20.0, 30.0)),
    )
    return SceneDescription(
        name="drop",
        solver=SolverSettings(rayleigh_stiffness=0.01, backend=backend),  # type: ignore[arg-type]
        bodies=(body(bridge, "bridge", young_modulus=1e5, total_mass=0.03),),
        joints=(JointDescription(name="slide", kind="prismatic", axis=(0.0, 0.0, 1.0)),),
        attachments=(slab("left", "world", -0.04, "bridge"), slab("right", "slide", 0.04, "bridge")),
        rigid_bodies=(ball, box),
        collisions=tuple(CollisionDescription(name=name, body=name) for name in ("bridge", "ball", "box")),
        contact=ContactSettings(friction=0.4, contact_distance=0.001, alarm_distance=0.004, tolerance=1e-11),
    )


def moved(sim: Simulation, steps: int) -> Simulation:
    """The simulation some steps on, its slide commanded up and down."""
    for _ in range(steps):
        sim.command([0.004 * np.sin(0.2 * sim.step_count)])
        sim.step()
    return sim


def test_in_contact_a_restored_snapshot_repeats_the_bytes(backend: str) -> None:
    sim = moved(Simulation(drop(backend)), 25)
    assert len(sim.contacts.points) > 0
    saved = sim.snapshot()
    later = moved(sim, 15).snapshot()
    sim.restore(saved)
    assert sim.snapshot() == saved
    assert moved(sim, 15).snapshot() == later
    other = Simulation(drop(backend))
    other.restore(saved)
    assert moved(other, 15).snapshot() == later


def test_a_reset_repeats_the_bytes_of_a_new_simulation() -> None:
    sim = moved(Simulation(drop()), 40)
    fallen = sim.snapshot()
    sim.reset()
    assert len(sim.contacts.points) == 0
    assert moved(sim, 40).snapshot() == fallen


@pytest.mark.slow
def test_both_steps_agree_in_contact() -> None:
    pytest.importorskip("numba")
    fast, plain = Simulation(drop("numba")), Simulation(drop("scipy"))
    touched = 0
    for _ in range(60):
        moved(fast, 1)
        moved(plain, 1)
        touched = max(touched, len(fast.contacts.points))
        assert np.abs(fast.positions - plain.positions).max() < 1e-7
        for a, b in zip(fast.rigid_poses, plain.rigid_poses, strict=True):
            assert np.abs(a.position - b.position).max() < 1e-7
            assert np.abs(a.quaternion_xyzw - b.quaternion_xyzw).max() < 1e-5  # 2e-7 m at the ball's surface
    assert touched > 1


def test_a_body_on_a_joint_moves_with_it() -> None:
    carried = RigidBodyDescription(
        name="cap",
        shape=Shape(box=(0.01, 0.01, 0.01)),
        on="arm",
        pose=Placement(translation=(0.0, 0.02, 0.0)),
    )
    arm = JointDescription(name="arm", axis=(0.0, 0.0, 1.0))
    bar = box_mesh((0.04, 0.01, 0.01), (4, 1, 1), (0.0, -0.005, -0.005))
    scene = SceneDescription(
        name="arm",
        bodies=(body(bar, "bar"),),
        joints=(arm,),
        attachments=(slab("driven", "arm", 0.0, "bar"),),
        rigid_bodies=(carried,),
    )
    sim = Simulation(scene)
    sim.command([0.5 * np.pi])
    for _ in range(3):
        sim.step()
    assert sim.rigid_poses[0].position == pytest.approx((-0.02, 0.0, 0.0), abs=1e-9)
    turned = sim.rigid_poses[0].quaternion_xyzw
    assert turned == pytest.approx((0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)), abs=1e-9)


@pytest.mark.parametrize(
    ("shape", "moments"),
    [
        (Shape(box=(0.02, 0.03, 0.04)), (0.0025, 0.0020, 0.0013)),
        (Shape(sphere=0.05), (0.001, 0.001, 0.001)),
        (Shape(cylinder=(0.02, 0.06)), (0.0004, 0.0004, 0.0002)),
    ],
)
def test_inertia_is_that_of_an_even_solid(shape: Shape, moments: tuple[float, float, float]) -> None:
    mass = {"box": 12.0, "sphere": 1.0, "cylinder": 1.0}[
        next(name for name in ("box", "sphere", "cylinder") if getattr(shape, name) is not None)
    ]
    scene = SceneDescription(
        name="solid", rigid_bodies=(RigidBodyDescription(name="thing", shape=shape, mass=mass),)
    )
    inertia = Simulation(scene).model.rigid.inertia[0]
    assert np.diag(inertia) == pytest.approx(moments, rel=0.02)
    assert np.abs(inertia - np.diag(np.diag(inertia))).max() < 1e-9
