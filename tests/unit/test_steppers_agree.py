"""The fast step and the readable one compute the same motion."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from small_scenes import assert_same, body, jittered, machine, scene, slab

from softsim_core.base import Placement
from softsim_core.physics.dynamics import make_stepper
from softsim_core.physics.mechanics import Control, State, rotation_exp
from softsim_core.physics.mesh import TetMesh, box_mesh
from softsim_core.scene import JointDescription, SceneDescription
from softsim_core.scene.building import build

pytest.importorskip("numba")
pytestmark = pytest.mark.numba

LAWS = ("polar", "qr")


def run_both(
    description: SceneDescription, steps: int, seed: int, force: float = 0.05, tolerance: float = 1e-10
) -> State:
    """Random commands, base shifts and node forces in [N] on both; returns the last state."""
    rng = np.random.default_rng(seed)
    built = build(description)
    model, parameters = built.model, built.parameters
    fast, readable = make_stepper(model, "numba"), make_stepper(model, "scipy")
    states = model.rest_state(), model.rest_state()
    reach = np.array([0.5 if joint.revolute else 0.003 for joint in model.joints])
    targets = states[0].joint_positions.copy()
    for step in range(steps):
        if step % 10 == 0:
            targets = states[0].joint_positions + rng.uniform(-reach, reach)
            forces = rng.normal(scale=force, size=model.rest.shape)
        control = Control(targets, forces, 0.002 * np.sin(step / 5.0))
        reports = [
            stepper.step(state, control, parameters)
            for stepper, state in zip((fast, readable), states, strict=True)
        ]
        assert reports[0].top_speed == pytest.approx(reports[1].top_speed, rel=1e-9)
        assert reports[0].inverted == reports[1].inverted
        assert reports[0].positive
        assert reports[1].positive
        assert_same(states[0], states[1], tolerance)
    assert np.abs(states[0].positions - model.rest).max() > 1e-4  # something moved
    return states[0]


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("seed", [0, 1])
def test_two_bodies_with_every_joint_frame_and_fixing(law: str, seed: int) -> None:
    last = run_both(machine(law), 50, seed)
    assert np.abs(last.joint_efforts).min() > 0.0


CASES: dict[str, dict[str, Any]] = {
    "free body": {},
    "held": {"attachments": (slab("held", "world", 0.0),)},
    "held at both ends": {"attachments": (slab("a", "world", 0.0), slab("b", "world", 0.06))},
    "soft": {"attachments": (slab("soft", "world", 0.0, stiffness=1e5),)},
    "free frame": {"attachments": (slab("frame", "free", 0.0),)},
    "two free frames": {"attachments": (slab("a", "free", 0.0), slab("b", "free", 0.06))},
    "two regions on one joint": {
        "joints": (JointDescription(name="hinge", axis=(0.0, 1.0, 0.0)),),
        "attachments": (slab("a", "hinge", 0.0), slab("b", "hinge", 0.06)),
    },
    "idle joint": {
        "joints": (JointDescription(name="idle"), JointDescription(name="hinge")),
        "attachments": (slab("a", "hinge", 0.0),),
    },
    "joints only on a compliant drive": {
        "joints": (JointDescription(name="hinge", axis=(0.0, 0.0, 1.0), stiffness=5.0, inertia=1e-6),),
        "attachments": (slab("a", "hinge", 0.0),),
    },
}


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("case", CASES)
def test_one_body(case: str, law: str) -> None:
    mesh = jittered(box_mesh((0.06, 0.02, 0.02), (6, 2, 2)), 0.002, seed=7)
    run_both(scene(body(mesh, total_mass=0.03), law=law, rayleigh_stiffness=0.002, **CASES[case]), 50, 3)


def test_two_bodies_that_do_not_touch_do_not_feel_each_other() -> None:
    near = body(box_mesh((0.03, 0.01, 0.01), (3, 1, 1)), "near")
    far = body(box_mesh((0.03, 0.01, 0.01), (3, 1, 1), (1.0, 0.0, 0.0)), "far")
    both = run_both(scene(near, far), 10, 0, force=0.0)
    alone = run_both(scene(near), 10, 0, force=0.0)
    np.testing.assert_allclose(both.positions[: len(alone.positions)], alone.positions, atol=1e-15)


@pytest.mark.filterwarnings("ignore:.*negative orientation")
@pytest.mark.parametrize("seed", range(4))
def test_any_node_numbering(seed: int) -> None:
    """Elimination order and element packing follow the node numbers; the motion must not."""
    rng = np.random.default_rng(seed)
    mesh = box_mesh((0.05, 0.02, 0.02), (5, 2, 2))
    order = rng.permutation(len(mesh.points))
    corners = np.argsort(rng.random(mesh.tets.shape), axis=1)
    tets = np.take_along_axis(np.argsort(order)[mesh.tets], corners, axis=1)[rng.permutation(len(mesh.tets))]
    shuffled = TetMesh(mesh.points[order], tets)
    run_both(scene(body(shuffled), attachments=(slab("held", "world", 0.0),)), 20, seed)


@pytest.mark.parametrize("law", LAWS)
def test_both_follow_tuned_parameters(law: str) -> None:
    built = build(machine(law))
    model, parameters = built.model, built.parameters
    fast, readable = make_stepper(model, "numba"), make_stepper(model, "scipy")
    states = model.rest_state(), model.rest_state()
    for step in range(30):
        targets = model.rest_state().joint_positions + 0.01 * np.sin(0.5 * step)
        control = Control(targets, np.zeros_like(model.rest))
        if step == 10:
            parameters.materials[0]["young_modulus"] *= 3.0
        if step == 20:
            parameters.rayleigh_stiffness, parameters.rayleigh_mass = 0.0, 4.0
        for stepper, state in zip((fast, readable), states, strict=True):
            stepper.step(state, control, parameters)
        assert_same(states[0], states[1], 1e-10)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("backend", "seed"),
    [
        ("numba", 0), ("numba", 1), ("numba", 2), ("scipy", 0),
        *(pytest.param("scipy", seed, marks=pytest.mark.exhaustive) for seed in (1, 2)),
    ],
)  # fmt: skip
def test_inverted_elements_come_back(backend: Any, seed: int) -> None:
    """Nodes thrown about, half of the elements inside out: with polar rotations the block finds its shape."""
    rng = np.random.default_rng(seed)
    mesh = box_mesh((0.04, 0.02, 0.02), (4, 2, 2))
    built = build(scene(body(mesh, total_mass=0.02), rayleigh_mass=5.0, gravity=(0.0, 0.0, 0.0)))
    state = built.model.rest_state()
    state.positions[:] = rng.uniform(-0.02, 0.02, state.positions.shape)
    corners = state.positions[mesh.tets]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1])
    assert (volumes < 0.0).sum() > 0.3 * len(volumes)
    stepper = make_stepper(built.model, backend)
    control = Control(np.zeros(0), np.zeros_like(built.model.rest))
    for _ in range(2000):
        if not stepper.step(state, control, built.parameters).top_speed > 1e-7:
            break
    edges = np.concatenate([mesh.tets[:, [a, b]] for a in range(4) for b in range(a)])
    lengths = np.linalg.norm(state.positions[edges[:, 0]] - state.positions[edges[:, 1]], axis=1)
    rest = np.linalg.norm(mesh.points[edges[:, 0]] - mesh.points[edges[:, 1]], axis=1)
    np.testing.assert_allclose(lengths, rest, atol=1e-5)
    corners = state.positions[mesh.tets]
    assert (np.linalg.det(corners[:, 1:] - corners[:, :1]) > 0.0).all()


def test_a_held_body_does_not_move() -> None:
    """Nothing to solve for: every node held."""
    mesh = box_mesh((0.02, 0.01, 0.01), (2, 1, 1))
    held = tuple(slab(f"held_{i}", "world", 0.01 * i) for i in range(3))
    built = build(scene(body(mesh), attachments=held))
    for backend in ("numba", "scipy"):
        state = built.model.rest_state()
        stepper = make_stepper(built.model, backend)  # type: ignore[arg-type]
        stepper.step(state, Control(np.zeros(0), np.ones_like(built.model.rest)), built.parameters)
        np.testing.assert_array_equal(state.positions, mesh.points)


def test_only_joints_move() -> None:
    """No free node: a rigid block on a compliant hinge."""
    mesh = box_mesh((0.02, 0.01, 0.01), (2, 1, 1))
    regions = tuple(slab(f"region_{i}", "hinge", 0.01 * i) for i in range(3))
    turn = Placement(translation=(0.0, 0.0, 0.1))
    hinge = JointDescription(name="hinge", base=turn, axis=(0.0, 1.0, 0.0), stiffness=1.0, inertia=1e-4)
    last = run_both(scene(body(mesh, total_mass=0.1), joints=(hinge,), attachments=regions), 50, 1)
    rotated = (mesh.points - [0.0, 0.0, 0.1]) @ rotation_exp(
        last.joint_positions[0] * np.array([0.0, 1.0, 0.0])
    ).T
    shift = np.array([float(last.base_shift[0]), 0.0, 0.1])
    np.testing.assert_allclose(last.positions, rotated + shift, atol=1e-14)
