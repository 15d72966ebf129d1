"""Chambers are part of the compiled step, beside cables and kinds without kernels; both back ends agree."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softsim_core import Simulation, load_scene
from softsim_core.base import Box, Placement
from softsim_core.physics.actuation.cable import CableDescription
from softsim_core.physics.actuation.chamber import Chamber, ChamberDescription
from softsim_core.physics.contact import ContactSettings
from softsim_core.physics.mesh import Shape, TetMesh, box_mesh
from softsim_core.scene import (
    AttachmentDescription,
    BodyDescription,
    CollisionDescription,
    JointDescription,
    MaterialDescription,
    RigidBodyDescription,
    SceneDescription,
)

pytest.importorskip("numba")
EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "my_actuator.py"


def hollow(name: str, place: float, order: int) -> BodyDescription:
    """A cube of 40 mm around a hollow of 20 mm."""
    whole = box_mesh((0.04,) * 3, (4, 4, 4), (place, -0.02, -0.02))
    middle = whole.points[whole.tets].mean(axis=1) - [place + 0.02, 0.0, 0.0]
    kept = whole.tets[~(np.abs(middle) < 0.01).all(axis=1)]
    used, tets = np.unique(kept, return_inverse=True)
    rubber = MaterialDescription(law="stable_neo_hookean", young_modulus=1e5, poisson_ratio=0.45)
    mesh = TetMesh(whole.points[used], tets.reshape(-1, 4))
    return BodyDescription(name=name, mesh=mesh, order=order, material=rubber, density=1000.0)


def blown(touching: bool) -> SceneDescription:
    """A linear and a quadratic cube; air in each, in one behind a line; a cable, and a kind in NumPy."""
    tendon = replace(
        load_scene(EXAMPLE).scene.joints[0].actuator,
        body="first",
        point=(0.036, 0.0, 0.015),
        winch=(0.1, 0.02, 0.06),
    )  # type: ignore[type-var]
    wire = CableDescription(
        body="first", points=((0.004, 0.015, 0.0), (0.02, 0.015, 0.0), (0.036, 0.015, 0.0))
    )
    line = ChamberDescription(body="second", control="volume", line_volume=2e-6, leak=1e-11)
    joints = (
        JointDescription(name="line", kind="chamber", actuator=line),
        JointDescription(name="tendon", kind="elastic_tendon", actuator=tendon),
        JointDescription(name="air", kind="chamber", actuator=ChamberDescription(body="first")),
        JointDescription(name="wire", kind="cable", actuator=wire),
    )
    ends = ((0.0, "first", "world"), (0.04, "first", "free"), (0.1, "second", "world"))
    attachments = [
        AttachmentDescription(
            name=f"{body}_{to}", body=body, to=to, box=Box(center=(x, 0.0, 0.0), size=(1e-4, 0.1, 0.1))
        )
        for x, body, to in ends
    ]
    ball = RigidBodyDescription(
        name="ball", shape=Shape(sphere=0.01), mass=0.02, pose=Placement(translation=(0.12, 0.0, 0.0305))
    )
    return SceneDescription(
        name="blown",
        contact=ContactSettings(tolerance=1e-12),  # both to the same forces
        bodies=(hollow("first", 0.0, 1), hollow("second", 0.1, 2)),
        joints=joints,
        attachments=tuple(attachments),
        rigid_bodies=(ball,) if touching else (),
        collisions=tuple(
            CollisionDescription(name=each, body=each) for each in ("second", "ball") * touching
        ),
    )


@pytest.mark.parametrize("touching", [False, True])
@pytest.mark.slow
def test_both_back_ends_agree_on_chambers_beside_other_kinds(touching: bool) -> None:
    fast, readable = (Simulation(blown(touching), backend=each) for each in ("numba", "scipy"))
    for step in range(8):
        for simulation in (fast, readable):
            simulation.command([1e-6 * step, 0.004, 300.0 * step, 0.0005 * step])
            simulation.step()
        assert np.abs(fast.positions - readable.positions).max() < 1e-10
        scale = np.maximum(np.abs(readable.joint_efforts), 1.0)
        assert (np.abs(fast.joint_efforts - readable.joint_efforts) < 1e-6 * scale).all()
        assert np.abs(fast.joint_positions - readable.joint_positions).max() < 1e-12
        rates = [each._state.reduced_velocities for each in (fast, readable)]
        assert np.abs(rates[0] - rates[1]).max() < 1e-8
    if touching:
        assert len(fast.contacts.points) > 0


def test_a_compiled_step_measures_chambers_in_compiled_code(monkeypatch: pytest.MonkeyPatch) -> None:
    simulation = Simulation(load_scene("inflated_cube"), backend="numba")
    simulation.command([5e3])

    def refuse(*_: object) -> float:
        raise AssertionError("a chamber was measured in NumPy")

    monkeypatch.setattr(Chamber, "value", refuse)
    monkeypatch.setattr(Chamber, "row", refuse)
    for _ in range(3):
        simulation.step()
    assert simulation.joint_positions[0] > 0.0
