"""Static solves: the same rest as the dynamics, few iterations, a typed refusal where there is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from closed_forms import uniaxial_stretch
from small_scenes import body, machine, scene, slab

from softsim_core import Simulation, load_scene
from softsim_core.base import NotConvergedError, SoftSimError
from softsim_core.physics.dynamics import StaticSolution, make_stepper, solve_static, statics
from softsim_core.physics.mechanics import Control
from softsim_core.physics.mesh import box_mesh
from softsim_core.scene import MaterialDescription
from softsim_core.scene.building import BuiltScene, build

LAWS = ("polar", "qr")
LENGTH, HEIGHT, YOUNG = 0.1, 0.01, 1e6
STIFFNESS = YOUNG * HEIGHT**4 / 12.0 / LENGTH**2
"""E I / L^2 of the beam in [N]: the unit of its tip load."""


def beam(law: str = "polar") -> BuiltScene:
    mesh = box_mesh((LENGTH, HEIGHT, HEIGHT), (20, 2, 2))
    walls = (slab("wall", "world", 0.0),)
    return build(scene(body(mesh, young_modulus=YOUNG), law=law, gravity=(0.0, 0.0, 0.0), attachments=walls))


def pulled(built: BuiltScene, force: tuple[float, float, float], **options: float) -> StaticSolution:
    """Static pose under a force on the tip in [N]."""
    tip = np.flatnonzero(built.model.rest[:, 0] > LENGTH - 1e-9)
    forces = np.zeros_like(built.model.rest)
    forces[tip] = np.array(force) / len(tip)
    control = Control(np.zeros(0), forces)
    return solve_static(built.model, built.model.rest_state(), control, built.parameters, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("law", LAWS)
def test_statics_are_where_the_dynamics_come_to_rest(law: str, backend: str) -> None:
    """Two bodies with every joint, frame and fixing, loaded and shifted."""
    built = build(machine(law))
    model = built.model
    control = Control(
        np.array([-0.3, 0.25, 0.004, 0.003]),
        np.random.default_rng(0).normal(scale=0.01, size=model.rest.shape),
        base_shift=0.002,
    )
    solution = solve_static(model, model.rest_state(), control, built.parameters)
    state = model.rest_state()
    stepper = make_stepper(model, backend)  # type: ignore[arg-type]
    for _ in range(3000):
        if stepper.step(state, control, built.parameters).top_speed < 1e-11:
            break
    for quantity in ("positions", "frame_positions", "frame_rotations", "joint_positions"):
        expected = getattr(state, quantity)
        np.testing.assert_allclose(
            getattr(solution.state, quantity), expected, rtol=0, atol=1e-9, err_msg=quantity
        )
    np.testing.assert_allclose(solution.state.joint_efforts, state.joint_efforts, rtol=1e-6, atol=1e-8)
    assert solution.residual < 1e-9


@pytest.mark.parametrize("pose", ["start", "mid", "high"])
def test_our_tripod_from_rest_to_its_poses(pose: str) -> None:
    sim = Simulation(load_scene("tripod"), backend="scipy")
    control = Control(np.array(sim.robot.poses[pose]), sim.forces, 0.035)
    solution = solve_static(sim.model, sim.model.rest_state(), control, sim.parameters)
    again = solve_static(sim.model, solution.state, control, sim.parameters)
    assert again.iterations == 1
    np.testing.assert_allclose(again.state.positions, solution.state.positions, rtol=0, atol=1e-12)


def drooping(law: str, young_modulus: float) -> Simulation:
    """A beam of rubber that hangs under its weight, down by up to its own length."""
    constants = {
        "stable_neo_hookean": {"young_modulus": young_modulus},
        "yeoh": {"c1": young_modulus / 6.0},
    }[law]
    rubber = MaterialDescription(law=law, **constants, poisson_ratio=0.45)  # type: ignore[arg-type]
    beam = replace(body(box_mesh((0.2, 0.02, 0.02), (40, 4, 4))), material=rubber, total_mass=0.08)
    return Simulation(scene(beam, attachments=(slab("wall", "world", 0.0),), gravity=(0.0, 0.0, -9.81)))


@pytest.mark.slow
@pytest.mark.parametrize("law", ["stable_neo_hookean", "yeoh"])
@pytest.mark.parametrize(("young_modulus", "most"), [(2e5, 12), (5e4, 20), (2e4, 20)])
def test_rubber_that_droops_is_found_in_few_iterations(law: str, young_modulus: float, most: int) -> None:
    """10 to 17; the three of the first law took 82, 156 and 32 before they began with Hooke's law."""
    found = drooping(law, young_modulus).equilibrium()
    assert found.iterations <= most
    assert found.residual < 1e-9


@pytest.mark.slow
def test_rubber_droops_to_the_same_place_in_parts_of_the_load(monkeypatch: pytest.MonkeyPatch) -> None:
    found = drooping("stable_neo_hookean", 2e5).equilibrium()
    others = {way: most for way, most in statics.WAYS.items() if way != "rotated"}
    monkeypatch.setattr(statics, "WAYS", others)  # delitem would put it back at the end
    in_parts = drooping("stable_neo_hookean", 2e5).equilibrium()
    assert in_parts.load_steps > found.load_steps
    np.testing.assert_allclose(found.state.positions, in_parts.state.positions, rtol=0.0, atol=1e-10)


@pytest.mark.slow
def test_load_steps_of_a_hopeless_load_end_after_their_most_iterations(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Without the bound they end where they get too short."""

    def iterations() -> int:
        with pytest.raises(NotConvergedError) as refused:
            pulled(beam(), (-1e4 * STIFFNESS, 0.0, 1.0))
        return refused.value.iterations

    unbounded = iterations()
    monkeypatch.setattr(statics, "PATIENCE", 0)
    monkeypatch.setattr(statics, "MOST_IN_PARTS", 0)
    assert iterations() < 0.6 * unbounded


@pytest.mark.parametrize(
    ("law", "load", "most"),
    [("polar", 0.5, 8), ("polar", 5.0, 9), ("polar", 30.0, 9), ("qr", 0.5, 8), ("qr", 30.0, 35)],
)
def test_straight_beam_to_a_large_bend_in_few_iterations(law: str, load: float, most: int) -> None:
    built = beam(law)
    solution = pulled(built, (0.0, 0.0, load * STIFFNESS))
    assert solution.load_steps == 1
    assert solution.iterations <= most
    if load == 30.0:  # the tip hangs in the direction of the pull
        tip = solution.state.positions[built.model.rest[:, 0] > LENGTH - 1e-9].mean(axis=0)
        assert tip[2] > 0.85 * LENGTH
        assert tip[0] < 0.35 * LENGTH


def test_last_iterations_converge_quadratically() -> None:
    built = beam()
    few = [
        pulled(built, (0.0, 0.0, 2.0 * STIFFNESS), tolerance=10.0**-digits).iterations
        for digits in (4, 8, 15)
    ]
    assert few[2] - few[0] <= 4


def test_start_is_not_changed_and_the_end_is_at_rest() -> None:
    built = build(machine())
    start = built.model.rest_state()
    start.velocities[built.model.free_nodes] = 1.0
    before = start.buffer.copy()
    control = Control(start.joint_positions + 0.002, np.zeros_like(built.model.rest))
    solution = solve_static(built.model, start, control, built.parameters)
    np.testing.assert_array_equal(start.buffer, before)
    assert not solution.state.velocities.any()
    assert not solution.state.reduced_velocities.any()


@pytest.mark.slow
def test_statics_from_a_crumpled_start() -> None:
    """A start with inverted elements leads to the same pose, or to a refusal: never to a wrong answer."""
    built = beam()
    expected = pulled(built, (0.0, 0.0, STIFFNESS)).state.positions
    tip = np.flatnonzero(built.model.rest[:, 0] > LENGTH - 1e-9)
    forces = np.zeros_like(built.model.rest)
    forces[tip, 2] = STIFFNESS / len(tip)
    found = 0
    for seed in range(5):
        start, free = built.model.rest_state(), built.model.free_nodes
        start.positions[free] += np.random.default_rng(seed).normal(scale=0.002, size=(len(free), 3))
        try:
            solution = solve_static(built.model, start, Control(np.zeros(0), forces), built.parameters)
        except NotConvergedError:
            continue
        np.testing.assert_allclose(solution.state.positions, expected, rtol=0, atol=1e-9)
        found += 1
    assert found > 0


@pytest.mark.slow
def test_a_free_body_under_gravity_has_no_rest() -> None:
    built = build(scene(body(box_mesh((0.02, 0.01, 0.01), (2, 1, 1)))))
    with pytest.raises(NotConvergedError, match="no static equilibrium found") as caught:
        solve_static(
            built.model,
            built.model.rest_state(),
            Control(np.zeros(0), np.zeros_like(built.model.rest)),
            built.parameters,
        )
    assert isinstance(caught.value, SoftSimError)
    assert caught.value.iterations > 0


@pytest.mark.slow
def test_a_column_that_buckles_is_not_called_stable() -> None:
    """Straight is an equilibrium at any load; above the critical one nothing would stay in it."""
    built = beam()
    critical = np.pi**2 / 4.0 * STIFFNESS / 0.58  # Euler, over the bending locking of two layers
    straight = pulled(built, (-0.9 * critical, 0.0, 0.0))
    assert np.abs(straight.state.positions - built.model.rest)[:, 2].max() < 1e-4
    with pytest.raises(NotConvergedError, match="only an unstable one") as caught:
        pulled(built, (-1.3 * critical, 0.0, 0.0))
    assert caught.value.fraction == pytest.approx(1.0 / 1.3, rel=0.05)


@pytest.mark.slow
def test_an_unstable_equilibrium_is_not_returned_as_it_was_given(monkeypatch: pytest.MonkeyPatch) -> None:
    """The straight column again, as the first state: it buckles, or is refused."""
    built = beam()
    tip = np.flatnonzero(built.model.rest[:, 0] > LENGTH - 1e-9)
    forces = np.zeros_like(built.model.rest)
    forces[tip, 0] = -1.3 * np.pi**2 / 4.0 * STIFFNESS / 0.58 / len(tip)
    control = Control(np.zeros(0), forces)
    with monkeypatch.context() as accepting:
        accepting.setattr(statics.StaticProblem, "_accept", lambda *_: None)
        straight = solve_static(built.model, built.model.rest_state(), control, built.parameters).state
    assert np.abs(straight.positions - built.model.rest)[:, 1:].max() < 1e-4
    try:
        found = solve_static(built.model, straight, control, built.parameters).state
    except NotConvergedError:
        return
    aside = (found.positions - built.model.rest)[:, 1:]  # to which side is a matter of rounding
    assert np.linalg.norm(aside, axis=1).max() > 0.1 * LENGTH


@pytest.mark.parametrize("force", [np.nan, np.inf])
def test_what_is_not_finite_is_refused_at_once(force: float) -> None:
    with pytest.raises(NotConvergedError, match="not finite") as caught:
        pulled(beam(), (0.0, 0.0, force))
    assert caught.value.iterations == 0


@pytest.mark.parametrize("stiffness", [1e3, 1e9])
def test_soft_fixings_of_any_stiffness(stiffness: float) -> None:
    """A bar pulled at one end and held by springs at the other moves by force over stiffness."""
    mesh = box_mesh((LENGTH, HEIGHT, HEIGHT), (4, 1, 1))
    bar = body(mesh, young_modulus=YOUNG, poisson_ratio=0.0)
    springs = (slab("springs", "world", 0.0, stiffness=stiffness),)
    built = build(scene(bar, gravity=(0.0, 0.0, 0.0), attachments=springs))
    solution = pulled(built, (1.0, 0.0, 0.0))
    moved = (solution.state.positions - mesh.points)[:, 0]
    at_wall, at_tip = moved[mesh.points[:, 0] < 1e-9], moved[mesh.points[:, 0] > LENGTH - 1e-9]
    assert at_wall.mean() == pytest.approx(1.0 / (4.0 * stiffness), rel=1e-6)
    expected = LENGTH * uniaxial_stretch(1.0, HEIGHT**2, YOUNG)
    assert at_tip.mean() - at_wall.mean() == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(
    "start",
    ["mirrored", "mirrored along x", "flat", "a point", "crumpled", "huge", "endless", "not a number"],
)
@pytest.mark.slow
def test_a_start_that_is_no_shape_ends_in_a_sentence_or_at_rest(law: str, start: str) -> None:
    mesh = box_mesh((0.04, 0.02, 0.02), (2, 1, 1))
    built = build(scene(body(mesh), law=law, attachments=(slab("wall", "world", 0.0),)))
    model, state = built.model, built.model.rest_state()
    free = model.free_nodes
    noise = np.random.default_rng(4).normal(size=(len(free), 3))
    state.positions[free] = {
        "mirrored": -state.positions[free],
        "mirrored along x": state.positions[free] * [-1.0, 1.0, 1.0],
        "flat": state.positions[free] * [1.0, 1.0, 0.0],
        "a point": 0.0 * noise,
        "crumpled": state.positions[free] + 0.05 * noise,
        "huge": 1e8 * noise,
        "endless": 1e300 * noise,
        "not a number": np.nan * noise,
    }[start]
    control = Control(np.zeros(0), np.zeros_like(model.rest))
    try:
        solution = solve_static(model, state, control, built.parameters)
    except NotConvergedError:  # its sentence is tested elsewhere; anything else is a leak
        return
    assert np.isfinite(solution.state.positions).all()
    assert solution.residual < 1e-6
