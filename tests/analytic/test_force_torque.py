"""What a sensor at the flange of a swinging arm feels: Newton's and Euler's laws of what hangs there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_scenes import body, scene, slab

from softsim_core import ForceTorqueDescription, SceneError, Simulation
from softsim_core.base import Array, Backend, Placement
from softsim_core.physics.mechanics import rotation_euler, rotation_exp
from softsim_core.physics.mesh import box_mesh
from softsim_core.scene import JointDescription, SceneDescription

DT = 0.005
POSE = Placement(translation=(0.01, -0.02, 0.005), rotation_deg=(20.0, -30.0, 40.0))
"""Of the sensor in the last joint's frame."""
AXES = np.array([[0.0, 0.6, 0.8], [0.8, 0.0, 0.6]])
ORIGINS = np.array([[-0.25, 0.0, 0.0], [-0.05, 0.02, 0.03]])


def arm(*sensors: ForceTorqueDescription) -> SceneDescription:
    """A block of 0.1 kg, nearly rigid, on two tilted hinges."""
    joints = tuple(
        JointDescription(
            name=f"joint_{k}",
            axis=tuple(AXES[k].tolist()),
            base=Placement(translation=tuple(ORIGINS[k].tolist())),
            parent=f"joint_{k - 1}" if k else None,
        )
        for k in range(2)
    )
    block = body(box_mesh((0.06, 0.04, 0.03), (2, 1, 1)), young_modulus=1e9, total_mass=0.1)
    root = slab("root", "joint_1", 0.0)
    return replace(scene(block, joints=joints, attachments=(root,)), dt=DT, sensors=sensors)


FLANGE = ForceTorqueDescription(name="flange", on="joint_1", pose=POSE)


def way(time: float) -> Array:
    """Where the joints are, in [rad]; they swing, 4 and 6 rad/s."""
    start = time * time / (0.05 + time * time)  # without a jerk
    return np.array([1.0 * np.sin(4.0 * time), 0.5 * np.sin(6.0 * time)]) * start


def moved(points: Array, time: float) -> tuple[Array, Array]:
    """Points (k, 3) that stand on the last joint at rest, and its rotation."""
    q, turn = way(time), np.eye(3)
    for k in (1, 0):
        about = rotation_exp(q[k] * AXES[k])
        points, turn = (points - ORIGINS[k]) @ about.T + ORIGINS[k], about @ turn
    return points, turn


def expected(simulation: Simulation, time: float) -> Array:
    """The wrench on a rigid body with the block's masses, by numerical differences of the closed form."""
    rest, mass, step = simulation.model.rest, simulation.model.mass, 1e-4
    behind, here, ahead = (moved(rest, time + k * step)[0] for k in (-1, 0, 1))
    forces = mass[:, None] * ((ahead - 2.0 * here + behind) / step**2 - simulation.model.gravity)
    turn = moved(rest, time)[1] @ rotation_euler(np.radians(POSE.rotation_deg))
    origin = moved((ORIGINS[1] + np.array(POSE.translation))[None], time)[0][0]
    return np.concatenate([forces.sum(axis=0) @ turn, np.cross(here - origin, forces).sum(axis=0) @ turn])


def test_the_flange_feels_newtons_law_of_a_swinging_arm(backend: Backend) -> None:
    simulation = Simulation(arm(FLANGE), backend)
    errors, sizes = [], []
    for k in range(1, 240):
        simulation.command(way(k * DT))
        simulation.step()
        if k > 20:
            wanted = expected(simulation, (k - 1) * DT)
            errors.append(simulation.sensors["flange"].value - wanted)
            sizes.append(wanted)
    for part in (slice(0, 3), slice(3, 6)):
        largest = np.linalg.norm(np.array(sizes)[:, part], axis=1).max()
        error = np.linalg.norm(np.array(errors)[:, part], axis=1)
        assert error.max() < 0.005 * largest
    assert np.linalg.norm(np.array(sizes)[:, :3], axis=1).max() > 1.25 * 0.1 * 9.81  # it swings, not hangs


def test_at_rest_it_feels_weight_and_pulls(backend: Backend) -> None:
    simulation = Simulation(arm(FLANGE), backend)
    simulation.forces[-1] = (0.3, -0.2, 0.1)
    for _ in range(40):
        simulation.step()
    force = np.array([0.0, 0.0, 0.1 * 9.81]) - [0.3, -0.2, 0.1]
    turn = rotation_euler(np.radians(POSE.rotation_deg))
    assert simulation.sensors["flange"].value[:3] == pytest.approx(force @ turn, rel=1e-3)


def test_a_body_that_is_held_elsewhere_is_refused() -> None:
    base = arm(replace(FLANGE, on="joint_1"))
    held = replace(base, attachments=(*base.attachments, slab("wall", "world", 0.06)))
    with pytest.raises(SceneError, match="sensor flange: the body body is held elsewhere, too"):
        Simulation(held)


def test_it_sits_on_a_joint() -> None:
    with pytest.raises(SceneError, match="sensor flange: root is no joint"):
        Simulation(arm(replace(FLANGE, on="root")))
