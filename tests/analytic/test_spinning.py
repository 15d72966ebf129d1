"""Bodies that spin: damping takes no turning for a strain, and steps of several iterations do not dilate."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from small_scenes import scene

from softsim_core import Simulation
from softsim_core.base import Array, Box, Placement
from softsim_core.physics.mesh import box_mesh
from softsim_core.scene import (
    AttachmentDescription,
    BodyDescription,
    JointDescription,
    LayerDescription,
    MaterialDescription,
    RodDescription,
    RodSectionDescription,
    SceneDescription,
)

LENGTH, WIDTH, YOUNG, DENSITY = 0.2, 0.01, 1e6, 1000.0
BACKENDS = [
    pytest.param("scipy", marks=pytest.mark.slow),
    pytest.param("numba", marks=pytest.mark.numba),
]


def bar(
    law: str, order: int, dt: float, poisson_ratio: float = 0.0, held: bool = False, **solver: Any
) -> SceneDescription:
    """A bar along x about the origin, free, or on a hinge that holds its left end."""
    material = MaterialDescription(law=law, young_modulus=YOUNG, poisson_ratio=poisson_ratio)
    width, cells = (4.0 * WIDTH, 5) if held else (WIDTH, 8)  # one that hardly bends as it speeds up
    start = (-LENGTH / 2, -width / 2, -width / 2)
    body = BodyDescription(
        name="bar",
        mesh=box_mesh((LENGTH, width, width), (cells, 1, 1), start),
        order=order,
        material=material,
        density=DENSITY,
    )
    base = Placement(translation=(-LENGTH / 2, 0.0, 0.0))
    hinge = JointDescription(name="hinge", axis=(0.0, 0.0, 1.0), base=base)
    end = Box(center=start, size=(1e-4, 1.0, 1.0))
    root = AttachmentDescription(name="root", body="bar", to="hinge", box=end)
    fields = {"joints": (hinge,), "attachments": (root,)} if held else {}
    described = scene(body, gravity=(0.0, 0.0, 0.0), dt=dt, **fields)
    return replace(described, solver=replace(described.solver, **solver))


def rod(dt: float, own_damping: float = 0.0, **solver: Any) -> SceneDescription:
    """The same bar as a rod; `own_damping` in [s]."""
    section = RodSectionDescription(shape="rectangle", size=(WIDTH, WIDTH))
    line = ((-LENGTH / 2, 0.0, 0.0), (LENGTH / 2, 0.0, 0.0))
    drawn = RodDescription(centreline=line, section=section, first_axis=(0.0, 0.0, 1.0), elements=8)
    material = MaterialDescription(law="rod", young_modulus=YOUNG, poisson_ratio=0.3, damping=own_damping)
    body = BodyDescription(name="bar", rod=drawn, material=material, density=DENSITY)
    described = scene(body, gravity=(0.0, 0.0, 0.0), dt=dt)
    return replace(described, solver=replace(described.solver, **solver))


def length(simulation: Simulation) -> float:
    rest, x = simulation.model.rest[:, 0], simulation.positions
    low, high = (x[np.abs(rest - end) < 1e-9].mean(axis=0) for end in (-LENGTH / 2, LENGTH / 2))
    return float(np.linalg.norm(high - low))


def spin(simulation: Simulation) -> float:
    x, mass = simulation.positions, simulation.model.mass
    return float((mass @ np.cross(x, simulation.velocities))[2] / (mass @ (x[:, 0] ** 2 + x[:, 1] ** 2)))


def stretch_over_expected(
    rate: float, backend: str, described: SceneDescription, steps: int, lag: float = 0.0
) -> float:
    """Of a free bar, over the second half: its mean stretch over rho omega^2 L^3 / (12 E).

    With what a damped one creeps behind by a time [s], since implicit Euler slows the spin down.
    """
    simulation = Simulation(described, backend)  # type: ignore[arg-type]
    simulation.set_body_velocity("bar", angular_velocity=(0.0, 0.0, rate))
    found, expected = [], []
    for _ in range(steps):
        simulation.step()
        found.append(length(simulation) - LENGTH)
        expected.append(DENSITY * spin(simulation) ** 2 * LENGTH**3 / (12.0 * YOUNG))
    half = steps // 2
    creep = lag * (found[-1] - found[half]) / (simulation.dt * (steps - 1 - half))
    return float((np.mean(found[half:]) + creep) / np.mean(expected[half:]))


CASES = [
    (scheme, rate, dt, damping)
    for scheme in ("bossak", "implicit_euler")
    for rate in (1.0, 4.0, 10.0, 40.0)
    for dt in (0.002, 0.01)
    for damping in (0.0, 2e-3, 1e-2)
    if rate * dt < 0.2
]
SAMPLE = [CASES[k] for k in np.random.default_rng(3).permutation(len(CASES))[:3]]


def spun(case: tuple[str, float, float, float], backend: str) -> float:
    scheme, rate, dt, damping = case
    described = bar(
        "stable_neo_hookean", 2, dt, time_integration=scheme, iterations=5, rayleigh_stiffness=damping
    )
    lag = damping + dt if scheme == "implicit_euler" else 0.0
    return stretch_over_expected(rate, backend, described, round(0.4 / dt), lag)


@pytest.mark.numba
@pytest.mark.slow
@pytest.mark.parametrize("case", [("bossak", 40.0, 0.002, 2e-3), *SAMPLE])
def test_a_spinning_bar_stretches_as_it_should(case: tuple[str, float, float, float]) -> None:
    assert spun(case, "numba") == pytest.approx(1.0, abs=0.02)


@pytest.mark.exhaustive
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("case", CASES)
def test_a_bar_stretches_at_every_spin_step_and_damping(
    case: tuple[str, float, float, float], backend: str
) -> None:
    assert spun(case, backend) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("damping", [0.0, 1e-2])
def test_a_free_bar_is_not_dilated_in_one_iteration(damping: float, backend: str) -> None:
    described = bar("stable_neo_hookean", 2, 0.002, rayleigh_stiffness=damping)
    assert stretch_over_expected(10.0, backend, described, 100) == pytest.approx(1.0, abs=0.02)


def driven(described: SceneDescription, rate: float, seconds: float, backend: str) -> Simulation:
    """A bar on a hinge that has sped up to a rate in [rad/s] and kept it."""
    simulation, ramp = Simulation(described, backend), 0.3  # type: ignore[arg-type]
    for k in range(round(seconds / simulation.dt)):
        t = (k + 1) * simulation.dt
        simulation.command([rate * (0.5 * t**2 / ramp if t < ramp else t - 0.5 * ramp)])
        simulation.step()
    return simulation


@pytest.mark.slow
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(("law", "order"), [("stable_neo_hookean", 2), ("corotational", 1)])
def test_a_damped_bar_on_a_spinning_hinge_is_not_dilated(law: str, order: int, backend: str) -> None:
    """rho omega^2 L^3 / (3 E)."""
    described = bar(law, order, 0.005, held=True, iterations=5, rayleigh_stiffness=0.01)
    simulation = driven(described, 10.0, 0.8, backend)
    expected = DENSITY * 100.0 * LENGTH**3 / (3.0 * YOUNG)
    assert length(simulation) - LENGTH == pytest.approx(expected, rel=0.03)
    assert simulation.report.dilation == 0.0


def test_the_report_says_how_far_one_iteration_dilates() -> None:
    """omega^2 dt (dt + damping) / 2, of the length of a bar on a spinning hinge."""
    one = driven(bar("corotational", 1, 0.005, held=True, rayleigh_stiffness=0.01), 10.0, 0.8, "scipy")
    dilation = one.report.dilation
    assert dilation == pytest.approx(100.0 * 0.005 * 0.015 / 2.0, rel=1e-2)
    expected = DENSITY * 100.0 * LENGTH**3 / (3.0 * YOUNG)
    assert length(one) - LENGTH - expected == pytest.approx(dilation * LENGTH, rel=0.1)


FLYING = {"time_integration": "bossak", "iterations": 3, "rayleigh_stiffness": 0.01}


def layered_bar() -> SceneDescription:
    """A bar of quadratic cells with a thin stiff sheet on one of its sides."""
    described = bar("stable_neo_hookean", 2, 5e-4, 0.3, **FLYING)
    side = Box(center=(0.0, 0.0, WIDTH / 2), size=(1.0, 1.0, 1e-5))
    sheet = LayerDescription(name="sheet", thickness=1e-4, young_modulus=10.0 * YOUNG, box=side)
    return replace(described, bodies=(replace(described.bodies[0], layers=(sheet,)),))


@pytest.mark.slow
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(
    "described",
    [
        pytest.param(bar("stable_neo_hookean", 2, 5e-4, 0.3, **FLYING), id="tet10"),
        pytest.param(bar("corotational", 1, 5e-4, 0.3, **FLYING), id="tet4"),
        pytest.param(layered_bar(), id="layer"),
        pytest.param(rod(5e-4, **FLYING), id="rod"),
        pytest.param(rod(5e-4, 0.01, **{**FLYING, "rayleigh_stiffness": 0.0}), id="rod of its own damping"),
    ],
)
def test_a_damped_body_that_flies_and_turns_keeps_its_angular_momentum(
    described: SceneDescription, backend: str
) -> None:
    """Once the stretch of the spin, which begins all at once, has rung down."""
    simulation = Simulation(described, backend)  # type: ignore[arg-type]
    simulation.set_body_velocity("bar", velocity=(1.0, 0.2, 0.5), angular_velocity=(0.5, 0.0, 5.0))

    def momentum() -> Array:
        mass, x, v = simulation.model.mass, simulation.positions, simulation.velocities
        arms, rates = (each - mass @ each / mass.sum() for each in (x, v))
        return np.asarray(np.cross(arms, simulation.model.momentum(rates)).sum(axis=0))

    for _ in range(150):
        simulation.step()
    start = momentum()
    for _ in range(150):
        simulation.step()
    assert np.abs(momentum() - start).max() < 1e-6 * np.linalg.norm(start)


ROD_CASES = [("bossak", 40.0, 0.002, 1e-2), ("implicit_euler", 10.0, 0.01, 1e-2), ("bossak", 1.0, 0.01, 0.0)]


@pytest.mark.slow
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("case", ROD_CASES)
def test_a_spinning_rod_stretches_as_it_should(case: tuple[str, float, float, float], backend: str) -> None:
    scheme, rate, dt, damping = case
    described = rod(dt, time_integration=scheme, iterations=5, rayleigh_stiffness=damping)
    lag = damping + dt if scheme == "implicit_euler" else 0.0
    assert stretch_over_expected(rate, backend, described, round(0.4 / dt), lag) == pytest.approx(
        1.0, abs=0.02
    )


@pytest.mark.slow
@pytest.mark.numba
@pytest.mark.parametrize(("law", "order"), [("stable_neo_hookean", 2), ("corotational", 1)])
def test_parts_that_turn_against_each_other_are_dilated_by_little(law: str, order: int) -> None:
    """Less than the strain damping * dt * omega^2 / 2 of halves that fold at omega, in proportion to dt."""
    rate, damping, seconds = 10.0, 0.01, 0.12

    def stretches(dt: float) -> Array:
        """Of the line through the middles of sections, each 20 ms."""
        described = bar(law, order, dt, time_integration="bossak", iterations=6, rayleigh_stiffness=damping)
        simulation = Simulation(described, "numba")
        rest = simulation.model.rest[:, 0]
        simulation._state.velocities[:, 1] = rate * np.abs(rest)
        places, found = np.unique(rest.round(9)), []
        for step in range(round(seconds / dt)):
            simulation.step()
            if (step + 1) % round(0.02 / dt) == 0:
                line = [simulation.positions[np.abs(rest - x) < 1e-9].mean(axis=0) for x in places]
                found.append(np.linalg.norm(np.diff(line, axis=0), axis=1).sum() / LENGTH - 1.0)
        return np.array(found)

    right = stretches(0.00125)
    coarse, finer = (np.abs(stretches(dt) - right).max() for dt in (0.01, 0.005))
    assert coarse < 0.5 * damping * 0.01 * rate**2
    assert finer < 0.75 * coarse
