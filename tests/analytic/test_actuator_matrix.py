"""Every kind of actuator against finite differences, statics, its bounds, and both back ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cable_scenes import bent_bar, cable_joint

from softsim_core import Simulation, load_scene
from softsim_core.base import Array, Backend, Placement
from softsim_core.physics.actuation import Actuators, LoadDescription, Placed, Surroundings, actuator_kinds
from softsim_core.physics.dynamics import Unknowns, jacobian, rows_on_unknowns, static_tangent
from softsim_core.physics.mechanics import JointLimits, State, rotation_exp
from softsim_core.scene import JointDescription, SceneDescription

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "my_actuator.py"
load_scene(EXAMPLE)  # registers a kind of actuator


def driven() -> SceneDescription:
    """A bar on a slide with a spring that a prescribed slide carries."""
    up = JointDescription(name="up", kind="prismatic", axis=(0.0, 0.0, 1.0))
    aside = JointDescription(
        name="aside", kind="prismatic", axis=(0.0, 1.0, 0.0), parent="up", stiffness=300.0, inertia=1e-3
    )
    return bent_bar(up, aside, held="aside", tip=True)


def pulled() -> SceneDescription:
    """A cable with a largest tension whose pull point is on a springy arm on a hinge that a slide carries."""
    up = JointDescription(name="up", kind="prismatic", axis=(0.0, 0.0, 1.0), stiffness=500.0, inertia=1e-3)
    swing = JointDescription(
        name="swing", parent="up", axis=(0.36, 0.48, 0.8), base=Placement(translation=(-0.03, 0.01, 0.02))
    )
    arm = JointDescription(
        name="arm",
        parent="swing",
        base=Placement(translation=(-0.02, 0.0, -0.01), rotation_deg=(0.0, 0.0, 20.0)),
        stiffness=0.2,
        inertia=1e-5,
    )
    cable = cable_joint(pull_point=(-0.025, 0.003, 0.006), pull_on="arm", max_tension=1.2)
    return bent_bar(cable, up, swing, arm, tip=True)


def tied() -> SceneDescription:
    """The tendon of the example, aslant and under gravity."""
    scene = load_scene(EXAMPLE).scene
    tendon = replace(scene.joints[0].actuator, winch=(0.15, 0.04, 0.08))  # type: ignore[type-var]
    solver = replace(scene.solver, rayleigh_stiffness=0.05)
    joint = replace(scene.joints[0], actuator=tendon)
    return replace(scene, joints=(joint,), gravity=(0.0, 0.0, -9.81), solver=solver)


def blown() -> SceneDescription:
    """A hollow cube filled by volume, with a free frame on the side away from the wall."""
    scene = load_scene("inflated_cube").scene
    chamber = replace(scene.joints[0].actuator, control="volume", min_pressure=-1e3, max_pressure=5e3)  # type: ignore[type-var]
    limits = JointLimits(-1e-5, 1e-5, 1e-3, 1e9)
    return replace(scene, joints=(replace(scene.joints[0], actuator=chamber, limits=limits),))


def pushed() -> SceneDescription:
    """A force on the end of a bar, which a free frame carries."""
    force = LoadDescription(body="bar", point=(0.1, 0.0, 0.0), force=(0.6, 0.0, 0.8))
    return bent_bar(JointDescription(name="push", kind="load", actuator=force), tip=True)


CASES: dict[str, tuple[Callable[[], SceneDescription], list[float]]] = {
    "joint_drive": (driven, [0.004, -0.006]),
    "cable": (pulled, [0.006, 0.002, 0.1, 0.05]),
    "elastic_tendon": (tied, [0.01]),
    "chamber": (blown, [1.2e-6]),
    "load": (pushed, [0.02]),
}
"""Scene of each kind, and a command."""

kinds = pytest.mark.parametrize("kind", CASES)


def test_every_registered_kind_is_in_this_matrix() -> None:
    assert set(actuator_kinds()) == set(CASES)


def of_kind(kind: str, simulation: Simulation) -> Actuators:
    """The actuators of a kind in a scene; drives are built here, as the step takes them into its matrix."""
    if kind != "joint_drive":
        return simulation._actuators
    placed = [Placed(joint.name, j, None) for j, joint in enumerate(simulation.model.joints)]
    return Actuators([actuator_kinds()[kind].build(placed, Surroundings(simulation.model, {}, {}))])


def bent(simulation: Simulation, rng: np.random.Generator) -> State:
    """A state away from rest."""
    state, model = simulation.model.rest_state(), simulation.model
    at = Unknowns(model)
    return moved(simulation, state, rng.normal(size=at.size) * 1e-3)


def moved(simulation: Simulation, state: State, step: Array) -> State:
    """A state with all unknowns moved; frames turn by the exponential."""
    model, at = simulation.model, Unknowns(simulation.model)
    after = model.empty_state()
    after.copy_from(state)
    after.positions[at.free] += step[: at.first_reduced].reshape(-1, 3)
    for f in range(len(model.frame_names)):
        shift, turn = step[at.first_reduced + 6 * f :][:6].reshape(2, 3)
        after.frame_positions[f] += shift
        after.frame_rotations[f] = rotation_exp(turn) @ after.frame_rotations[f]
    after.joint_positions += step[at.joints]
    model.place_regions(after)
    return after


@kinds
def test_rows_are_the_derivatives_of_the_coordinate(kind: str) -> None:
    rng = np.random.default_rng(1)
    simulation = Simulation(CASES[kind][0](), "scipy")
    model, at, actuators = simulation.model, Unknowns(simulation.model), of_kind(kind, simulation)
    state = bent(simulation, rng)
    rows = rows_on_unknowns(model, at, jacobian(model, at, state), actuators.rows(model, state)).on_unknowns
    for _ in range(5):
        step = 1e-6 * rng.normal(size=at.size)
        ahead, behind = (
            actuators.values(model, moved(simulation, state, sign * step)) for sign in (1.0, -1.0)
        )
        assert rows @ step == pytest.approx(0.5 * (ahead - behind), rel=1e-6, abs=1e-13)


@kinds
def test_geometric_stiffness_is_how_the_forces_turn(kind: str) -> None:
    rng = np.random.default_rng(2)
    simulation = Simulation(CASES[kind][0](), "scipy")
    model, at, actuators = simulation.model, Unknowns(simulation.model), of_kind(kind, simulation)
    state, multipliers = bent(simulation, rng), rng.uniform(0.5, 2.0, len(actuators))

    def forces(where: State) -> Array:
        return np.asarray(
            rows_on_unknowns(
                model, at, jacobian(model, at, where), actuators.rows(model, where)
            ).on_unknowns.T
            @ multipliers
        )

    rows = rows_on_unknowns(model, at, jacobian(model, at, state), actuators.rows(model, state))
    on_nodes = (rows.on_nodes.T @ multipliers).reshape(-1, 3)
    none = 0.0 * rows.on_nodes.T @ rows.on_nodes
    stiffness = static_tangent(model, at, state, on_nodes, none, jacobian(model, at, state)).toarray()
    stiffness[at.joints, at.joints] -= at.drive
    geometric = actuators.geometric_stiffness(model, state, multipliers)
    across = rows_on_unknowns(model, at, jacobian(model, at, state), geometric.rows).on_unknowns.toarray()
    stiffness += across.T @ (geometric.weight[:, None] * across)
    for _ in range(5):
        way = rng.normal(size=at.size)
        ahead, behind = (forces(moved(simulation, state, sign * 1e-6 * way)) for sign in (1.0, -1.0))
        assert way @ stiffness @ way == pytest.approx(-way @ (ahead - behind) / 2e-6, rel=1e-5, abs=1e-7)


@kinds
def test_dynamics_come_to_rest_where_statics_say(kind: str, backend: Backend) -> None:
    make, command = CASES[kind]
    simulation = Simulation(make(), backend)
    still = simulation.equilibrium(command).state
    simulation.command(command)
    for _ in range(250):
        simulation.step()
    assert np.abs(simulation.positions - still.positions).max() < 1e-7
    assert np.abs(simulation.joint_positions - still.joint_positions).max() < 1e-7
    assert simulation.joint_efforts == pytest.approx(still.joint_efforts, rel=1e-5, abs=1e-7)


@pytest.mark.slow
@kinds
def test_both_back_ends_agree_and_bounds_are_kept(kind: str) -> None:
    pytest.importorskip("numba")
    make, command = CASES[kind]
    fast, readable = (Simulation(make(), each) for each in ("numba", "scipy"))  # type: ignore[arg-type]
    actuators, rng, reached = of_kind(kind, fast), np.random.default_rng(3), set()
    for step in range(60):
        if step % 6 == 0:
            wanted = (rng.uniform(-1.0, 3.0, len(command)) * command).tolist()
        for simulation in (fast, readable):
            simulation.command(wanted)
            simulation.step()
        assert np.abs(fast.positions - readable.positions).max() < 1e-9
        assert np.abs(fast.joint_positions - readable.joint_positions).max() < 1e-9
        assert np.abs(fast.joint_velocities - readable.joint_velocities).max() < 1e-6
        own = np.array(wanted)[actuators.joint]
        _, _, lower, upper, _ = actuators.transmissions(fast.model, fast.model.rest_state(), own)
        efforts = fast.joint_efforts[actuators.joint]
        assert (efforts >= lower).all()
        assert (efforts <= upper).all()
        reached |= {*np.flatnonzero(efforts == lower), *(10 + np.flatnonzero(efforts == upper))}
    if kind not in ("joint_drive", "load"):  # these push and pull
        assert 0 in reached  # slack at times
