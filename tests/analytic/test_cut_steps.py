"""Steps that are cut in parts: what rests stays, and what is reported as a force of the step is its mean."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from contact_scenes import touching
from sampled_cases import sampled
from small_scenes import scene
from test_chambers import hollow, inflated
from test_pump_lines import GIVEN, LINES

from softsim_core import Simulation, load_scene
from softsim_core.base import Box, Placement
from softsim_core.physics.actuation.cable import CableDescription
from softsim_core.physics.dynamics import substeps
from softsim_core.physics.mesh import Shape, box_mesh
from softsim_core.physics.sensing import (
    ForceTorqueDescription,
    SimulatedSensorDescription,
    TactileArrayDescription,
    WrenchSensorDescription,
)
from softsim_core.scene import (
    AttachmentDescription,
    BodyDescription,
    JointDescription,
    MaterialDescription,
    RigidBodyDescription,
    SceneDescription,
)

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "my_actuator.py"
RUBBER = MaterialDescription(law="stable_neo_hookean", young_modulus=2e5, poisson_ratio=0.3)


@pytest.fixture
def cut(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every step is cut as often as it may be."""
    monkeypatch.setattr(substeps, "ROUGH", -1.0)


def end(name: str, to: str, x: float) -> AttachmentDescription:
    box = Box(center=(x, 0.005, 0.005), size=(0.002, 0.1, 0.1))
    return AttachmentDescription(name=name, body="beam", to=to, box=box)


def beam(*joints: JointDescription, root: str = "world") -> SceneDescription:
    """A beam of rubber that is held at one end."""
    soft = BodyDescription(
        name="beam", mesh=box_mesh((0.06, 0.01, 0.01), (6, 1, 1)), material=RUBBER, total_mass=0.006
    )
    return scene(soft, joints=joints, attachments=(end("base", root, 0.0),))


def on_cable(**values: Any) -> SceneDescription:
    points = tuple((x, 0.005, 0.009) for x in np.linspace(0.008, 0.05, 5).tolist())
    return beam(
        JointDescription(
            name="cable", kind="cable", actuator=CableDescription(body="beam", points=points, **values)
        )
    )


def on_drive(**values: Any) -> SceneDescription:
    return beam(
        JointDescription(name="slide", kind="prismatic", axis=(0.0, 0.0, 1.0), **values), root="slide"
    )


def chamber(**line: Any) -> SceneDescription:
    return inflated(hollow(), backend="scipy", **line)


def tendon() -> SceneDescription:
    """A user's own kind: example `my_actuator`."""
    described = load_scene(EXAMPLE).scene
    bar = replace(
        described.bodies[0], material=RUBBER, mesh=box_mesh((0.1, 0.02, 0.02), (5, 1, 1), (0.0, -0.01, -0.01))
    )
    return replace(described, bodies=(bar,))


AT_REST: dict[str, tuple[SceneDescription, float]] = {
    "taut cable": (on_cable(), 0.002),
    "slack cable": (on_cable(), -0.003),
    "cable at its largest tension": (on_cable(max_tension=0.1), 0.01),
    "cable that pushes": (on_cable(pull_only=False), -0.001),
    "cable by force": (on_cable(control="force"), 0.2),
    "tendon": (tendon(), 0.005),
    "drive": (on_drive(), 0.004),
    "drive with a spring": (on_drive(stiffness=50.0, inertia=1e-3), 0.004),
    "chamber by pressure": (chamber(control="pressure"), 3e3),
    "chamber by volume": (chamber(control="volume"), 1e-6),
    "water behind a line that gives way": (chamber(control="volume", line_compliance=1e-10), 1e-6),
    **{f"line: {kind}": (chamber(**line), GIVEN[kind]) for kind, line in LINES.items()},
}


@pytest.mark.usefixtures("cut")
@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "scheme"),
    sampled("cut steps", [(kind, scheme) for kind in AT_REST for scheme in ("implicit_euler", "bossak")]),
)
def test_what_rests_under_a_constant_command_stays(kind: str, scheme: Any) -> None:
    described, command = AT_REST[kind]
    solver = replace(described.solver, time_integration=scheme, backend="scipy")
    simulation = Simulation(replace(described, solver=solver))
    simulation.settle([command])
    start, effort = simulation.positions, simulation.joint_efforts[0]
    for _ in range(3):
        simulation.step()
        assert simulation.report.parts == 8
        assert np.abs(simulation.positions - start).max() < 1e-9
        assert simulation.joint_efforts[0] == pytest.approx(effort, rel=1e-6, abs=1e-9)


def dropped(*sensors: SimulatedSensorDescription) -> SceneDescription:
    """A cube of rubber that falls on a rigid floor, and a rigid ball that falls on the cube; no friction."""
    cube = BodyDescription(
        name="cube",
        mesh=box_mesh((0.03,) * 3, (2, 2, 2), (-0.015, -0.015, 0.0012)),
        material=RUBBER,
        total_mass=0.03,
        velocity=(0.1, 0.0, -1.0),
    )
    ball = RigidBodyDescription(
        name="ball",
        shape=Shape(sphere=0.01),
        mass=0.02,
        pose=Placement(translation=(0.003, 0.002, 0.0425)),
        velocity=(0.0, 0.0, -1.5),
    )
    floor = RigidBodyDescription(
        name="floor", shape=Shape(box=(0.3, 0.3, 0.02)), pose=Placement(translation=(0.0, 0.0, -0.01))
    )
    described = touching(ball, floor, soft=(cube,), friction=0.0, gravity=(0.3, 0.0, -9.81), backend="scipy")
    return replace(described, sensors=sensors)


SKIN = TactileArrayDescription(
    name="skin", body="cube", box=Box(center=(0.0, 0.0, 0.0012), size=(0.1, 0.1, 0.001)), rows=3, columns=3
)
BELOW = WrenchSensorDescription(name="below", body="cube", other="floor")
AROUND = WrenchSensorDescription(name="around", body="cube")
ON_BALL = WrenchSensorDescription(name="on_ball", body="ball")


@pytest.mark.slow
@pytest.mark.parametrize("rough", [-1.0, 0.01])
def test_impulses_of_contacts_are_changes_of_momentum(rough: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Forces that sensors report, times dt, whether steps are cut in equal or in unequal parts."""
    monkeypatch.setattr(substeps, "ROUGH", rough)
    simulation = Simulation(dropped(SKIN, BELOW, AROUND, ON_BALL))
    model, dt = simulation.model, simulation.dt
    impulses, parts = dict.fromkeys((*simulation.sensors, "contacts"), 0.0), set()
    start = model.momentum(simulation.velocities).sum(axis=0), simulation.rigid_velocities[0, :3]
    for _ in range(12):
        simulation.step()
        parts.add(simulation.report.parts)
        for name in simulation.sensors:
            impulses[name] = impulses[name] + dt * simulation.sensors[name].value
        on_floor = (simulation.contacts.bodies == simulation.scene.body_names.index("floor")).any(axis=1)
        impulses["contacts"] = (
            impulses["contacts"] + dt * np.abs(simulation.contacts.forces[on_floor, 2]).sum()
        )
    assert max(parts) > 1
    weight = 12 * dt * model.gravity
    cube = model.momentum(simulation.velocities).sum(axis=0) - start[0] - 0.03 * weight
    ball = 0.02 * (simulation.rigid_velocities[0, :3] - start[1] - weight)
    assert cube[2] > 0.0
    assert ball[2] > 0.02
    np.testing.assert_allclose(impulses["around"][:3], cube, atol=1e-6)
    np.testing.assert_allclose(impulses["on_ball"][:3], ball, atol=1e-6)
    np.testing.assert_allclose(impulses["below"][:3], cube + ball, atol=1e-6)
    assert impulses["skin"].sum() * 1e-4 == pytest.approx((cube + ball)[2], abs=1e-6)
    assert impulses["contacts"] == pytest.approx((cube + ball)[2], abs=1e-6)


@pytest.mark.usefixtures("cut")
def test_impulses_of_joints_are_changes_of_momentum() -> None:
    """Of a drive that shakes a beam, and of the sensor at its flange, with drag."""
    flange = ForceTorqueDescription(name="flange", on="slide")
    described = replace(on_drive(), sensors=(flange,), gravity=(0.0, 0.0, -9.81))
    solver = replace(described.solver, backend="scipy", rayleigh_mass=2.0, substeps=4)
    simulation = Simulation(replace(described, solver=solver))
    model, dt = simulation.model, simulation.dt
    effort, drag, felt = 0.0, 0.0, 0.0
    for k in range(15):
        simulation.command([0.003 * np.sin(0.9 * k)])
        before = simulation.positions
        simulation.step()
        effort += dt * simulation.joint_efforts[0]
        felt += dt * simulation.sensors["flange"].value[2]
        drag += 2.0 * model.momentum(simulation.positions - before).sum(axis=0)[2]
    change = model.momentum(simulation.velocities).sum(axis=0)[2] + drag + 15 * dt * 9.81 * 0.006
    assert effort == pytest.approx(change, abs=1e-6)
    assert felt == pytest.approx(change, abs=1e-6)
