"""Cables are part of the step: both implementations agree, with slack, force, sliding bases, and contacts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from softsim_core import Simulation
from softsim_core.base import Array, Box, Placement
from softsim_core.physics.actuation.cable import CableDescription
from softsim_core.physics.contact import ContactSettings
from softsim_core.physics.mechanics import Control
from softsim_core.physics.mesh import Shape, box_mesh
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


def pulled_beam(touching: bool = False, rubber: bool = False) -> SceneDescription:
    """A beam on a slide, a free frame at its tip, four cables: along, to the frame, by force, slack.

    With `rubber` its cells are quadratic, so that the matrix of a step holds what taut cables add.
    """
    law = "stable_neo_hookean" if rubber else "corotational"
    beam = BodyDescription(
        name="beam",
        mesh=box_mesh((0.06, 0.01, 0.01), (5, 1, 1) if rubber else (9, 2, 2)),
        order=2 if rubber else 1,
        material=MaterialDescription(law=law, young_modulus=2e5, poisson_ratio=0.3),
        total_mass=0.006,
    )

    def cable(name: str, y: float, z: float, last: float, **values: Any) -> JointDescription:
        points = tuple((x, y, z) for x in np.linspace(0.008, last, 5).tolist())
        return JointDescription(
            name=name, kind="cable", actuator=CableDescription(body="beam", points=points, **values)
        )

    def end(name: str, to: str, x: float) -> AttachmentDescription:
        box = Box(center=(x, 0.005, 0.005), size=(0.002, 0.1, 0.1))
        return AttachmentDescription(name=name, body="beam", to=to, box=box)

    ball = RigidBodyDescription(
        name="ball", shape=Shape(sphere=0.005), mass=0.002, pose=Placement(translation=(0.03, 0.005, 0.0155))
    )
    return SceneDescription(
        name="pulled_beam",
        bodies=(beam,),
        joints=(
            JointDescription(
                name="slide", kind="prismatic", axis=(0.0, 0.0, 1.0), stiffness=300.0, inertia=1e-3
            ),
            cable("along", 0.009, 0.005, 0.05, pull_point=(-0.01, 0.009, 0.005), pull_on="slide"),
            cable("to_frame", 0.005, 0.009, 0.0599),
            cable("by_force", 0.001, 0.005, 0.04, control="force", pull_point=(-0.02, 0.0, 0.0)),
            cable("slack", 0.005, 0.001, 0.05),
        ),
        attachments=(end("base", "slide", 0.0), end("tip", "free", 0.06)),
        rigid_bodies=(ball,) if touching else (),
        collisions=tuple(CollisionDescription(name=name, body=name) for name in ("beam", "ball") * touching),
        contact=ContactSettings(tolerance=1e-12),  # both to the same forces
        effector="tip",
    )


def free_gaps(simulation: Simulation) -> Array:
    """What the cables' gaps are after another step without contacts; the simulation stays where it is."""
    state = simulation.model.empty_state()
    state.copy_from(simulation._state)
    control = Control(simulation.joint_targets, simulation.forces)
    return simulation._stepper.free_motion(state, control, simulation.parameters).violations


@pytest.mark.slow
@pytest.mark.parametrize(("touching", "rubber"), [(False, False), (True, False), (False, True)])
def test_both_implementations_agree(touching: bool, rubber: bool) -> None:
    fast, readable = (Simulation(pulled_beam(touching, rubber), backend=each) for each in ("numba", "scipy"))
    for step, along in enumerate(np.linspace(0.0, 0.004, 25).tolist() + [0.001] * 15):
        command = [0.002 * np.sin(0.3 * step), along, 0.5 * along + 0.002, 0.3, -0.002]
        for simulation in (fast, readable):
            simulation.command(command)
            simulation.step()
        assert np.abs(fast.positions - readable.positions).max() < 1e-10
        assert np.abs(fast.joint_efforts - readable.joint_efforts).max() < 1e-7
        assert np.abs(fast.joint_positions - readable.joint_positions).max() < 1e-10
        gaps = [free_gaps(simulation) for simulation in (fast, readable)]
        assert np.abs(gaps[0] - gaps[1]).max() < 1e-10
    tensions = dict(zip(fast.joint_names, fast.joint_efforts.tolist(), strict=True))
    assert tensions["by_force"] == 0.3
    assert tensions["slack"] == 0.0
    assert tensions["to_frame"] > 0.0
    if touching:
        assert len(fast.contacts.points) > 0


def test_taut_cables_keep_their_travel_and_only_pull() -> None:
    simulation = Simulation(pulled_beam(), backend="numba")
    simulation.command([0.0, 0.003, 0.002, 0.0, -0.01])
    for _ in range(300):
        simulation.step()
    cables = {cable.name: cable for cable in simulation.actuators}
    start = {cable.name: cable.length for cable in Simulation(pulled_beam(), backend="scipy").actuators}
    assert start["along"] - cables["along"].length == pytest.approx(0.003, abs=1e-9)
    assert start["to_frame"] - cables["to_frame"].length == pytest.approx(0.002, abs=1e-9)
    assert cables["along"].tension > 0.0
    assert cables["slack"].tension == 0.0
    assert start["slack"] - cables["slack"].length > -0.01
