"""Stress that relaxes: against the integral it stands for, in bodies, at rest, and tuned."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from small_scenes import comes_back_bit_for_bit, scene, slab

from softsim_core import Simulation
from softsim_core.base import Array, SceneError
from softsim_core.physics.fem import (
    ElementGroup,
    cell_forces,
    during_step,
    element_group,
    memory_shape,
    remember,
    step_stress,
    step_stress_forces,
    step_stress_stiffness,
)
from softsim_core.physics.fem.elements import element
from softsim_core.physics.fem.materials import material, relaxing
from softsim_core.physics.mechanics import rotation_exp
from softsim_core.physics.mesh import box_mesh, quadratic
from softsim_core.scene import BodyDescription, JointDescription, MaterialDescription, SceneDescription

TERMS = ((0.3, 0.05), (0.2, 0.4))
CONSTANTS: dict[str, dict[str, float]] = {
    "corotational": {"young_modulus": 1e5, "poisson_ratio": 0.4},
    "stable_neo_hookean": {"young_modulus": 1e5, "poisson_ratio": 0.45},
    "yeoh": {"c1": 1.5e4, "c2": 1e3, "poisson_ratio": 0.45},
    "ogden": {"m1": 3e4, "alpha1": 2.5, "m2": 1e3, "alpha2": -2.0, "poisson_ratio": 0.45},
}


def made_of(law: str, prony: tuple[tuple[float, float], ...] = TERMS) -> MaterialDescription:
    return MaterialDescription(law=law, prony=prony, **CONSTANTS[law])


def cells(law: str) -> tuple[ElementGroup, Array, Array]:
    """Quadratic cells of a small block, their values, and its points."""
    mesh = quadratic(box_mesh((0.01, 0.01, 0.01), (1, 1, 1)))
    count = np.arange(len(mesh.tets))
    group = element_group(
        element("tet10"), relaxing(material(law), len(TERMS)), mesh.points, mesh.tets, 0 * count, count
    )
    return group, group.values([made_of(law).values]), mesh.points


@pytest.mark.parametrize("law", CONSTANTS)
def test_forces_are_those_of_the_integral_over_the_past(law: str) -> None:
    """S = S0 - sum g / tau times the integral of exp(-(t - t') / tau) S0, while a block turns and bends."""
    group, p, points = cells(law)
    rng, memory = np.random.default_rng(4), np.zeros(memory_shape(group))
    ways = rng.uniform(-0.002, 0.002, (2, *points.shape))
    end, count = 0.5, 400
    h, seen = end / count, []
    bare = relaxing(material(law), len(TERMS)).law

    def places(t: float) -> Array:
        bent = points + np.sin(5.0 * t) * ways[0] + t * ways[1]
        return np.asarray(bent @ rotation_exp(t * np.array([1.0, 2.0, 0.5])).T)

    for k in range(count + 1):
        x = places(k * h)
        gradients = np.swapaxes(x[group.cells], 1, 2)[:, None] @ group.gradients
        own = group.material.own(p)[:, None]  # type: ignore[attr-defined]
        seen.append(np.linalg.solve(gradients, bare.shear_stress(gradients, own)))
        if k == count:
            break
        if k:
            remember(group, p, memory, x, h)
    held = step_stress(group, p, memory, h)
    values = group.values([during_step(group.material, made_of(law).values, h)])
    forces = cell_forces(group, x, values) + step_stress_forces(
        step_stress_stiffness(group, held), group.cells, x
    )

    times, stresses = h * np.arange(count + 1), np.array(seen)
    faded = np.zeros_like(stresses[-1])
    for share, time in TERMS:
        kernel = np.exp(-(end - times) / time) / time
        weights = np.full(count + 1, h)
        weights[[0, -1]] *= 0.5
        faded += share * np.einsum("k,k...->...", kernel * weights, stresses)
    first = group.values([{**made_of(law).values, "prony_share_1": 0.0, "prony_share_2": 0.0}])
    whole = cell_forces(group, x, first)
    pulls = group.weights[..., None, None] * (gradients @ faded)
    lost = (group.gradients @ np.swapaxes(pulls, -1, -2)).sum(axis=1)
    np.testing.assert_allclose(forces, whole + lost, atol=0.01 * np.abs(lost).max())


def held(law: str, backend: str = "auto", dt: float = 0.01, **fields: Any) -> SceneDescription:
    """A bar between two plates, one of which is pulled."""
    bar = BodyDescription(
        name="body",
        mesh=box_mesh((0.04, 0.01, 0.01), (4, 1, 1)),
        material=made_of(law),
        density=1000.0,
        **fields,
    )
    pull = JointDescription(name="pull", kind="prismatic", axis=(1.0, 0.0, 0.0))
    ends = (slab("held", "world", 0.0), slab("pulled", "pull", 0.04))
    described = scene(bar, joints=(pull,), attachments=ends, gravity=(0.0, 0.0, 0.0), dt=dt)
    return replace(described, solver=replace(described.solver, backend=backend))  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.parametrize("method", ["implicit_euler", "bossak"])
def test_a_bar_that_is_held_pulls_less_and_less(method: str) -> None:
    described = held("stable_neo_hookean", order=2)
    described = replace(
        described, solver=replace(described.solver, time_integration=method, rayleigh_mass=20.0)
    )
    simulation, efforts = Simulation(described), []
    simulation.command([0.002])
    for _ in range(200):
        simulation.step()
        efforts.append(float(simulation.joint_efforts[0]))
    rest = simulation.settle([0.002])
    long_term = float(rest.state.joint_efforts[0])
    times = 0.01 * np.arange(1, 201) - 0.005
    expected = 0.5 + 0.3 * np.exp(-times / 0.05) + 0.2 * np.exp(-times / 0.4)
    late = slice(20, None)
    np.testing.assert_allclose(0.5 * np.array(efforts)[late] / long_term, expected[late], rtol=0.02)
    for _ in range(5):
        simulation.step()
    np.testing.assert_allclose(simulation.joint_efforts[0], long_term, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.numba
@pytest.mark.parametrize(
    ("law", "order"), [("corotational", 1), ("corotational", 2), ("yeoh", 1), ("yeoh", 2)]
)
def test_both_back_ends_relax_alike(law: str, order: int) -> None:
    pytest.importorskip("numba")
    ends = []
    for backend in ("numba", "scipy"):
        simulation = Simulation(held(law, backend, order=order))
        for k in range(20):
            simulation.command([0.003 * np.sin(0.3 * k)])
            simulation.step()
        ends.append(simulation.positions.copy())
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-10)


def test_what_is_remembered_comes_back_with_a_snapshot() -> None:
    simulation = Simulation(held("yeoh", order=2))
    simulation.command([0.003])
    for _ in range(9):
        simulation.step()
    assert comes_back_bit_for_bit(simulation)


def test_terms_are_tuned_while_it_runs() -> None:
    simulation = Simulation(held("yeoh", order=2))
    simulation.command([0.002])
    for _ in range(300):
        simulation.step()
    half = float(simulation.joint_efforts[0])
    simulation.set_material("body", prony_share_1=1e-6, prony_share_2=1e-6)
    for _ in range(300):
        simulation.step()
    assert float(simulation.joint_efforts[0]) == pytest.approx(2.0 * half, rel=0.03)


@pytest.mark.parametrize(
    ("material_of", "sentence"),
    [
        (
            {"law": "corotational_qr", "young_modulus": 1e5, "poisson_ratio": 0.3},
            "does not separate shear from volume",
        ),
        ({"law": "yeoh", "c1": 1e4, "prony": ((0.6, 1.0), (0.5, 1.0))}, "prony_share_2 must be < 0.4"),
        ({"law": "yeoh", "c1": 1e4, "prony": ((0.6, 0.0),)}, "prony_time_1 must be > 0 s"),
        ({"law": "yeoh", "c1": 1e4, "prony": ((1.2, 1.0),)}, "prony_share_1 must be between 0 and 1"),
    ],
)
def test_terms_that_cannot_be_are_refused(material_of: dict[str, Any], sentence: str) -> None:
    values = {"prony": ((0.1, 1.0),), "poisson_ratio": 0.45, **material_of}
    with pytest.raises(SceneError, match=sentence):
        MaterialDescription(**values)


def test_a_description_is_what_its_plain_form_says() -> None:
    described = made_of("yeoh")
    assert described.plain()["prony"] == [{"share": 0.3, "time": 0.05}, {"share": 0.2, "time": 0.4}]
    preset = MaterialDescription(preset="Dragon Skin 20", prony=((0.1, 1.0),))
    assert preset.plain() == {"preset": "Dragon Skin 20", "prony": [{"share": 0.1, "time": 1.0}]}
    assert preset.with_values(prony_time_1=2.0).values["prony_time_1"] == 2.0
