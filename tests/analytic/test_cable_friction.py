"""Friction along cables: the capstan equation, hysteresis, memory of the path, statics and slow motion."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from cable_scenes import bent_bar, cable_joint
from small_scenes import body, scene, slab

from softsim_core import Simulation
from softsim_core.base import Array, Backend, Box, FieldError, Placement, SceneError
from softsim_core.physics.actuation.cable import CableView
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

RADIUS = 0.004
"""Of the circle on which a cable is led, in [m]."""
BAR = 1e7 * 0.012**2 / 0.1
"""Stiffness of the soft bar in [N/m]: E A / L."""
LIMITS = JointLimits(lower=-0.1, upper=100.0)


def circle(angle: float, height: float = 0.0) -> tuple[tuple[float, float, float], list[Any]]:
    """A pull point, and points on a circle that turn a cable by an angle, until it runs along x at y = 0."""
    steps = np.linspace(-angle, 0.0, 2 + int(angle / 0.2))
    points = [(RADIUS * np.sin(t), RADIUS * (1.0 - np.cos(t)), height) for t in steps]
    back = (np.cos(steps[0]), np.sin(steps[0]), 0.0)  # along the cable where it meets the circle
    start = tuple(float(p - 0.1 * d) for p, d in zip(points[0], back, strict=True))
    return start, [tuple(map(float, point)) for point in points]  # type: ignore[return-value]


def soft_bar(joint: JointDescription, *joints: JointDescription, **fields: Any) -> SceneDescription:
    """A bar from x = 0.02 m, held there, that a cable pulls at its free end; it does not contract across."""
    mesh = box_mesh((0.1, 0.012, 0.012), (6, 2, 2), (0.02, -0.006, -0.006))
    end = slab("end", "free", 0.12, "bar", frame=Placement(translation=(0.12, 0.0, 0.0)))
    return scene(
        body(mesh, "bar", 1e7, 0.0, 0.02),
        joints=(joint, *joints),
        attachments=(slab("held", "world", 0.02, "bar"), end),
        gravity=(0.0, 0.0, 0.0),
        rayleigh_stiffness=0.02,
        **fields,
    )


def led_over_guides(angle: float, **fields: Any) -> SceneDescription:
    """The cable is led over fixed guides to the end of the soft bar."""
    start, points = circle(angle)
    fields = {"points": ((0.12, 0.0, 0.0),), "pull_point": start, "guides": tuple(points), **fields}
    return soft_bar(cable_joint("c", limits=LIMITS, **fields))


def led_through_tetrahedra(angle: float, **fields: Any) -> SceneDescription:
    """The cable is led on a circle through a block that is held, to the soft end of the same body."""
    start, points = circle(angle)
    mesh = box_mesh((0.12, 0.024, 0.012), (10, 4, 2), (-0.03, -0.012, -0.006))
    held = AttachmentDescription(
        name="held", body="bar", to="world", box=Box(center=(0.0, 0.0, 0.0), size=(0.07, 1.0, 1.0))
    )
    cable = cable_joint("c", limits=LIMITS, points=(*points, (0.09, 0.0, 0.0)), pull_point=start, **fields)
    return scene(
        body(mesh, "bar", 1e7, 0.0, 0.02), joints=(cable,), attachments=(held,), gravity=(0.0, 0.0, 0.0)
    )


def led_through_a_rod(angle: float, **fields: Any) -> SceneDescription:
    """The cable is led on a circle within a thick, stiff rod."""
    start, points = circle(angle)
    rod = RodDescription(
        centreline=[(-0.03 + 0.012 * k, RADIUS, 0.0) for k in range(11)],
        section=RodSectionDescription(shape="rectangle", size=(0.024, 0.024)),
        first_axis=(0.0, 1.0, 0.0),
        elements=10,
    )
    material = MaterialDescription(law="rod", young_modulus=1e8, poisson_ratio=0.3)
    cable = cable_joint("c", limits=LIMITS, points=(*points, (0.09, 0.0, 0.0)), pull_point=start, **fields)
    return SceneDescription(
        name="rod",
        bodies=(BodyDescription(name="bar", rod=rod, material=material, density=1000.0),),
        joints=(cable,),
        attachments=(AttachmentDescription(name="held", body="bar", to="world", end="start"),),
        gravity=(0.0, 0.0, 0.0),
    )


LED = {"guides": led_over_guides, "tetrahedra": led_through_tetrahedra, "rod": led_through_a_rod}


def tensions(sim: Simulation, cable: int = 0) -> Array:
    """Tension of each segment of a cable in [N], from the pulled end on."""
    view = sim.actuators[cable]
    assert isinstance(view, CableView)
    return view.tensions


@pytest.mark.parametrize("angle", [0.0, 0.5 * np.pi, np.pi, 2.0 * np.pi, 4.0 * np.pi])
@pytest.mark.parametrize("kind", LED)
def test_tensions_at_the_ends_follow_the_capstan_equation(kind: str, angle: float) -> None:
    """Pulled, and let out until the whole cable slides back; the ratio is exp(friction angle) both times."""
    friction, held = 0.12, {"control": "force", "presliding": 1e-8}
    sim = Simulation(LED[kind](angle, friction=friction, **held))
    share = np.exp(-friction * angle)
    for pulled, ratio in ((5.0, share), (5.0 * 0.4 * share**2, 1.0 / share)):
        sim.settle([pulled], tolerance=1e-10)
        along = tensions(sim)
        assert along[0] == pytest.approx(pulled, rel=1e-9)
        assert along[-1] / along[0] == pytest.approx(ratio, rel=0.005)
    assert (np.diff(along) >= -1e-9).all()  # it slides back everywhere


@pytest.mark.parametrize("seed", range(4))
def test_loss_by_length_and_by_angle_multiply(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle, friction, by_length = rng.uniform(0.5, 6.0), rng.uniform(0.02, 0.2), rng.uniform(1.0, 8.0)
    losing = {"friction": friction, "friction_per_length": by_length, "presliding": 1e-8}
    sim = Simulation(led_over_guides(angle, **losing))
    lengths = np.linalg.norm(np.diff(sim.actuators[0].points, axis=0), axis=1)
    sim.settle([0.002])
    along = tensions(sim)
    channel = lengths.sum() - 0.5 * (lengths[0] + lengths[-1])  # from middle to middle of the end segments
    assert along[-1] / along[0] == pytest.approx(np.exp(-friction * angle - by_length * channel), rel=0.005)


def test_the_loop_of_one_bend_has_the_area_and_the_turning_points_of_its_closed_form() -> None:
    """The tension of a cable over a bend cycles: x = T exp(-+loss) / stiffness on the branches."""
    friction, angle, low, high = 0.3, 0.5 * np.pi, 0.4, 1.6
    bend = {"guides": ((0.0, 0.0, 0.0),), "pull_point": (0.0, -0.1, 0.0), "points": ((0.12, 0.0, 0.0),)}
    scene = soft_bar(
        cable_joint("c", limits=LIMITS, control="force", friction=friction, presliding=1e-8, **bend)
    )
    sim, loss = Simulation(scene), friction * angle
    up, down = np.geomspace(low, high, 80), np.geomspace(high, low, 80)
    path = np.concatenate([np.linspace(0.0, high, 10), down, up, down])
    moved = np.array([sim.settle([tension]).state.joint_positions[0] for tension in path])
    loop, place = path[-160:], moved[-160:]
    area = abs(np.trapezoid(np.append(loop, loop[0]), np.append(place, place[0])))
    far, near = high * np.exp(-loss) / BAR, low * np.exp(loss) / BAR
    assert place.max() == pytest.approx(far, rel=0.005)
    assert place.min() == pytest.approx(near, rel=0.005)
    assert area == pytest.approx(BAR * np.sinh(loss) * (far**2 - near**2), rel=0.02)
    sticking = place[80:] > far - 0.002 * (far - near)  # on the way down
    assert loop[80:][sticking].min() == pytest.approx(high * np.exp(-2.0 * loss), rel=0.02)


RUBBING = {"friction": 0.3, "friction_per_length": 4.0, "presliding": 2e-4}


def test_equilibria_along_a_path_are_those_of_slow_motion(backend: Backend) -> None:
    still, moving = (Simulation(bent_bar(cable_joint(**RUBBING), tip=True), backend) for _ in range(2))
    before = 0.0
    for command in (0.004, 0.001, 0.005):
        still.settle([command])
        for part in np.linspace(before, command, 121)[1:]:
            moving.command([part])
            moving.step()
        for _ in range(60):
            moving.step()
        before = command
        way = np.abs(still.positions - still.model.rest).max()
        assert np.abs(still.positions - moving.positions).max() < 0.01 * way
        assert tensions(moving) == pytest.approx(tensions(still), rel=0.01)


def test_the_place_depends_on_the_side_it_is_reached_from() -> None:
    places, frictionless = [], []
    for fields, found in ((RUBBING, places), ({}, frictionless)):
        sim = Simulation(bent_bar(cable_joint(**fields), tip=True))
        for commands in ((0.001, 0.003), (0.005, 0.003)):
            for command in commands:
                sim.settle([command])
            found.append(sim.positions.copy())
    assert np.abs(places[0] - places[1]).max() > 1e-3
    assert np.abs(frictionless[0] - frictionless[1]).max() < 1e-9


@pytest.mark.parametrize("statics", [True, False], ids=["statics", "steps"])
def test_a_path_repeats_itself_bit_by_bit_also_from_a_snapshot(backend: Backend, statics: bool) -> None:
    rng = np.random.default_rng(5)
    path = rng.uniform(-0.001, 0.005, 24).tolist()
    joints = (cable_joint(**RUBBING), cable_joint("other", compliance=1e-3, pretension=0.4, friction=0.2))

    def go(sim: Simulation, commands: list[float]) -> list[bytes]:
        seen = []
        for command in commands:
            if statics:
                sim.settle([command, 0.5 * command])
            else:
                sim.command([command, 0.5 * command])
                for _ in range(3):
                    sim.step()
            seen.append(sim.positions.tobytes() + sim.joint_efforts.tobytes() + tensions(sim).tobytes())
        return seen

    one, other = (Simulation(bent_bar(*joints, tip=True), backend) for _ in range(2))
    whole = go(one, path)
    assert go(other, path[:10]) == whole[:10]
    kept = other.snapshot()
    assert go(other, path[10:]) == whole[10:]
    resumed = Simulation(bent_bar(*joints, tip=True), backend)
    resumed.restore(kept)
    assert go(resumed, path[10:]) == whole[10:]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_back_ends_agree_and_friction_takes_energy(seed: int) -> None:
    """Random cables between random commands; over a closed path the motors' work is positive."""
    pytest.importorskip("numba")
    rng = np.random.default_rng(seed)
    joints = tuple(
        cable_joint(
            f"c{k}",
            points=tuple((0.001 + 0.014 * p, y, z) for p in range(7)),
            friction=rng.uniform(0.0, 0.5),
            friction_per_length=rng.uniform(0.0, 10.0),
            presliding=10.0 ** rng.uniform(-5.0, -3.0),
            compliance=float(rng.choice([0.0, 10.0 ** rng.uniform(-5.0, -2.0)])),
        )
        for k, (y, z) in enumerate(((0.0, 0.004), (0.004, -0.003), (-0.004, -0.003)))
    )
    path = rng.uniform(-0.001, 0.005, (12, 3))
    path[[0, 1, -2, -1]] = path[0]
    sims = [Simulation(bent_bar(*joints, tip=True), each) for each in ("numba", "scipy")]
    work = 0.0
    for before, command in pairwise(path):
        for part in np.linspace(before, command, 11)[1:]:
            pulled = sims[0].joint_efforts
            for sim in sims:
                sim.command(part)
                sim.step()
            work += float(0.5 * (pulled + sims[0].joint_efforts) @ (command - before)) / 10.0
        assert np.abs(sims[0].positions - sims[1].positions).max() < 1e-9
        for c in range(3):
            assert tensions(sims[0], c) == pytest.approx(tensions(sims[1], c), rel=1e-6, abs=1e-8)
            losses = np.abs(np.diff(np.log(np.maximum(tensions(sims[0], c), 1e-3))))
            assert (tensions(sims[0], c) >= -1e-9).all()
            assert losses.max() < 10.0
    assert work > 0.0


@pytest.mark.parametrize("start", [0.0, 0.5])
def test_guides_on_a_joint_load_it_as_their_forces_do(start: float) -> None:
    """A cable over guides on a hinge: its torque is the derivative of the work of all segments."""
    hinge = JointDescription(name="hinge", axis=(0.0, 0.0, 1.0), limits=JointLimits(-1.0, 1.0))
    led = {"guides": ((-0.02, 0.01, 0.0), (-0.01, -0.01, 0.002)), "pull_point": (-0.05, 0.004, 0.0)}
    cable = cable_joint(
        "c", limits=LIMITS, points=((0.12, 0.0, 0.0),), pull_on="hinge", control="force", **led
    )
    rubbing = replace(cable, actuator=replace(cable.actuator, friction=0.4, presliding=1e-7))  # type: ignore[type-var]
    torques = []
    for each in (cable, rubbing):
        sim = Simulation(soft_bar(each, hinge))
        sim.settle([0.0, start])
        sim.settle([1.5, start])
        view = sim.actuators[0]
        along = tensions(sim)
        forces = np.zeros_like(view.points)
        unit = np.diff(view.points, axis=0)
        unit /= np.linalg.norm(unit, axis=1, keepdims=True)
        forces[:-1] += along[:, None] * unit
        forces[1:] -= along[:, None] * unit
        carried = view.points[:3]
        wanted = np.cross(carried, forces[:3])[:, 2].sum()
        assert sim.joint_efforts[1] == pytest.approx(-wanted, rel=1e-6, abs=1e-9)
        torques.append(wanted)
        for step in range(40):
            sim.command([1.5, start + 0.002 * step])
            sim.step()
        assert np.isfinite(sim.positions).all()
    assert abs(torques[0] - torques[1]) > 1e-4


def test_what_cannot_rub_is_refused() -> None:
    with pytest.raises(FieldError, match="friction"):
        cable_joint(friction=-0.1)
    with pytest.raises(FieldError, match="presliding"):
        cable_joint(presliding=0.0)
    with pytest.raises(SceneError, match="only pull"):
        cable_joint(friction=0.1, pull_only=False)
    with pytest.raises(SceneError, match="guides needs a pull_point"):
        cable_joint(guides=((0.0, 0.0, 0.0),))
    with pytest.raises(SceneError, match="between the ends, and there are none"):
        Simulation(bent_bar(cable_joint(friction=0.1, points=((0.0, 0.0, 0.0), (0.1, 0.0, 0.0)))))
