"""Layers and fibres against closed forms and differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from softsim_core.base import Box, MaterialError, SceneError
from softsim_core.physics.fem import cell_energy, cell_forces, cell_stiffness
from softsim_core.physics.fem.materials import FIBRES, MEMBRANE
from softsim_core.physics.mechanics import rotation_exp
from softsim_core.physics.mesh import box_mesh
from softsim_core.scene import (
    AttachmentDescription,
    AxisDescription,
    BodyDescription,
    FibresDescription,
    LayerDescription,
    MaterialDescription,
    SceneDescription,
    SolverSettings,
)
from softsim_core.simulation import Simulation

LENGTH, WIDTH, HEIGHT = 0.08, 0.02, 0.01
PAPER = {"young_modulus": 1.0e9, "thickness": 1.0e-4}
BOTTOM = Box(center=(LENGTH / 2, WIDTH / 2, 0.0), size=(1.0, 1.0, 1e-5))


def scene(order: int = 2, cells: tuple[int, int, int] = (8, 2, 1), **given: Any) -> SceneDescription:
    """A bar along x, held at x = 0 where the scene says nothing else."""
    body = {
        "mesh": box_mesh((LENGTH, WIDTH, HEIGHT), cells),
        "material": MaterialDescription(law="stable_neo_hookean", young_modulus=1e5, poisson_ratio=0.45),
        "density": 1000.0,
        "order": order,
    }
    held = AttachmentDescription(
        name="wall", body="bar", to="world", box=Box(center=(0.0, 0.0, 0.0), size=(1e-5, 1.0, 1.0))
    )
    of_body = {"layers", "fibres", "material", "mesh"} & set(given)
    body |= {name: given.pop(name) for name in of_body}
    given = {"attachments": (held,), "gravity": (0.0, 0.0, 0.0)} | given
    return SceneDescription(name="bar", bodies=(BodyDescription(name="bar", **body),), **given)


def paper(**given: Any) -> LayerDescription:
    return LayerDescription(**({"name": "paper", "box": BOTTOM} | PAPER | given))


def wound(**given: Any) -> FibresDescription:
    middle = AxisDescription(through=(0.0, -0.05, -0.05), direction=(1.0, 0.0, 0.0))
    return FibresDescription(
        **({"name": "thread", "stiffness": 1e6, "around": middle, "angle_deg": 20.0} | given)
    )


@pytest.mark.parametrize("order", [1, 2])
def test_forces_and_tangent_are_derivatives_of_the_energy(order: int) -> None:
    simulation = Simulation(scene(order, (2, 1, 1), layers=(paper(),), fibres=(wound(),)))
    rng = np.random.default_rng(3)
    parts = [group for group in simulation.model.groups if not group.fills]
    assert {group.material for group in parts} == {MEMBRANE, FIBRES}
    for group in parts:
        p = group.values(simulation.parameters.materials)
        x = 1.3 * simulation.model.rest + 1e-3 * rng.normal(size=simulation.model.rest.shape)
        along = 1e-7 * rng.normal(size=x.shape)
        energy = cell_energy(group, x + along, p) - cell_energy(group, x - along, p)
        forces = cell_forces(group, x, p)
        np.testing.assert_allclose(
            -2.0 * np.einsum("mai,mai->m", forces, along[group.cells]), energy, rtol=1e-5
        )
        change = cell_forces(group, x + along, p) - cell_forces(group, x - along, p)
        stiffness = cell_stiffness(group, x, p)
        expected = -2.0 * np.einsum("mabij,mbj->mai", stiffness, along[group.cells])
        np.testing.assert_allclose(change, expected, atol=1e-5 * np.abs(expected).max())
        matrix = (
            cell_stiffness(group, x, p, positive=True)
            .swapaxes(2, 3)
            .reshape(len(p), x[0].size * len(group.element.reference), -1)
        )
        assert np.linalg.eigvalsh(matrix).min() > -1e-9 * np.abs(matrix).max()


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("has_moved", [False, True])
def test_both_back_ends_take_the_same_steps(order: int, has_moved: bool) -> None:
    rng = np.random.default_rng(5)
    stiff = rng.uniform(1e6, 1e9)
    given = {"layers": (paper(young_modulus=stiff),), "fibres": (wound(),), "gravity": (0.0, 3.0, -9.81)}
    one, other = (
        Simulation(scene(order, solver=SolverSettings(backend=backend, rayleigh_stiffness=0.01), **given))
        for backend in ("numba", "scipy")
    )
    for _ in range(8 if has_moved else 1):
        one.step()
        other.step()
    moved = np.abs(one.positions - one.model.rest).max()
    assert moved > 1e-4
    np.testing.assert_allclose(one.positions, other.positions, atol=1e-8 * moved)


@pytest.mark.parametrize("order", [1, 2])
def test_a_turned_body_has_no_stress_in_them(order: int) -> None:
    simulation = Simulation(scene(order, layers=(paper(),), fibres=(wound(),)))
    turned = simulation.model.rest @ rotation_exp(np.array([0.4, -1.1, 2.0])).T + 0.3
    for group in simulation.model.groups:
        if not group.fills:
            forces = cell_forces(group, turned, group.values(simulation.parameters.materials))
            assert np.abs(forces).max() < 1e-6


def test_a_layer_weighs_what_it_should_and_its_area_is_right() -> None:
    light, heavy = (Simulation(scene(layers=(paper(density=each),))) for each in (0.0, 700.0))
    added = heavy.model.mass.sum() - light.model.mass.sum()
    assert added == pytest.approx(700.0 * 1e-4 * LENGTH * WIDTH)


def end_force(order: int, stretch: float, **parts: Any) -> float:
    """Mean force along x on the held end in [N] of a bar whose faces slide, stretched along x."""
    simulation = Simulation(scene(order, (3, 2, 1), **parts))
    model, total = simulation.model, 0.0
    x = model.rest * np.array([stretch, 1.0, 1.0])
    for group in model.groups:
        if not group.fills:
            energy = [
                cell_energy(
                    group, x * [1.0 + eps, 1.0, 1.0], group.values(simulation.parameters.materials)
                ).sum()
                for eps in (-1e-6, 1e-6)
            ]
            total += (energy[1] - energy[0]) / (2e-6 * stretch * LENGTH)
    return float(total)


@pytest.mark.parametrize("order", [1, 2])
def test_pulled_parts_carry_the_closed_form(order: int) -> None:
    stretch = 1.2
    fibres = FibresDescription(name="along", stiffness=2e6, direction=(3.0, 0.0, 0.0))
    # dW/dstretch of k/2 (s^2 - 1)^2 over the section
    assert end_force(order, stretch, fibres=(fibres,)) == pytest.approx(
        2e6 * 2.0 * stretch * (stretch**2 - 1.0) * WIDTH * HEIGHT
    )
    assert end_force(order, 0.9, fibres=(fibres,)) == 0.0
    strain = 0.5 * (stretch**2 - 1.0)
    stiff = 1e9 / (1.0 - 0.3**2)
    assert end_force(order, stretch, layers=(paper(),)) == pytest.approx(
        stiff * strain * stretch * 1e-4 * WIDTH, rel=1e-6
    )


def test_wound_fibres_run_around_their_axis() -> None:
    """A body that grows away from the axis stretches the circles around it, at 90 deg it does not."""
    circles, along = (Simulation(scene(fibres=(wound(angle_deg=each),))) for each in (0.0, 90.0))
    for simulation, square in ((circles, 1.1**2), (along, 1.0)):
        group = simulation.model.groups[-1]
        middle = np.array([0.0, -0.05, -0.05])
        x = middle + (simulation.model.rest - middle) * [1.0, 1.1, 1.1]
        p = group.values(simulation.parameters.materials)
        volume = LENGTH * WIDTH * HEIGHT
        assert cell_energy(group, x, p).sum() == pytest.approx(
            0.5e6 * (square - 1.0) ** 2 * volume, abs=1e-12
        )


def test_rubber_with_paper_bends_as_a_beam_of_two_layers() -> None:
    """The stiffness in bending of the section with both, about its own neutral line."""
    force = 1e-4  # in N, across the end
    deflection = {}
    for name, layers in (("bare", ()), ("paper", (paper(),))):
        simulation = Simulation(scene(cells=(12, 2, 1), layers=layers))
        end = np.flatnonzero(simulation.model.rest[:, 0] > LENGTH - 1e-6)
        forces = np.zeros_like(simulation.model.rest)
        forces[end, 2] = force / len(end)
        simulation.forces = forces
        simulation.settle(())
        deflection[name] = (simulation.positions - simulation.model.rest)[end, 2].mean()
    rubber, sheet = 1e5 * HEIGHT, 1e9 * 1e-4  # membrane stiffness in N/m
    neutral = rubber * HEIGHT / 2.0 / (rubber + sheet)
    bending = rubber * (HEIGHT**2 / 12.0 + (HEIGHT / 2.0 - neutral) ** 2) + sheet * neutral**2
    assert deflection["bare"] / deflection["paper"] == pytest.approx(
        bending / (rubber * HEIGHT**2 / 12.0), rel=0.06
    )


@pytest.mark.parametrize(
    ("parts", "sentence"),
    [
        ({"layers": (lambda: paper(thickness=0.0),)}, "thickness must be > 0 m"),
        ({"layers": (lambda: paper(young_modulus=-1.0),)}, "young_modulus must be > 0 Pa"),
        ({"layers": (lambda: paper(box=None),)}, "exactly one of box and sphere"),
        (
            {"layers": (lambda: paper(box=Box(center=(1.0, 0.0, 0.0), size=(0.1,) * 3)),)},
            "no face of the body",
        ),
        ({"layers": (paper, paper)}, "share the name paper"),
        ({"fibres": (lambda: wound(direction=(1.0, 0.0, 0.0)),)}, "exactly one of direction and around"),
        ({"fibres": (lambda: wound(radii=(0.02, 0.01)),)}, "two rising distances"),
        ({"fibres": (lambda: wound(radii=(0.5, 0.6)),)}, "no cell of the body has its middle"),
        ({"fibres": (lambda: wound(angle_deg=100.0),)}, "angle_deg must be between -90 and 90 deg"),
    ],
)
def test_what_cannot_be_is_refused_in_a_sentence(parts: dict[str, Any], sentence: str) -> None:
    with pytest.raises(SceneError, match=sentence):
        Simulation(scene(**{kind: tuple(make() for make in makers) for kind, makers in parts.items()}))


def test_their_parameters_are_tuned_by_name() -> None:
    simulation = Simulation(scene(layers=(paper(),), fibres=(wound(),)))
    simulation.set_material("bar.paper", young_modulus=2e9)
    simulation.set_material("bar.thread", stiffness=3e5)
    kept = simulation.snapshot()
    assert simulation.parameters.materials[1:] == [
        {"young_modulus": 2e9, "poisson_ratio": 0.3},
        {"stiffness": 3e5},
    ]
    simulation.set_material("bar.thread", stiffness=1.0)
    simulation.restore(kept)
    assert simulation.parameters.materials[2] == {"stiffness": 3e5}
    with pytest.raises(
        SceneError,
        match=r"unknown body 'bar.cloth'; did you mean bar.thread\? known bodies: bar, bar.paper",
    ):
        simulation.set_material("bar.cloth", stiffness=1.0)
    with pytest.raises(MaterialError, match="stiffness"):
        simulation.set_material("bar.thread", stiffness=-1.0)
