"""Chambers: volumes and what follows from them, pressure against volume, balloons through their maximum."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.spatial import ConvexHull
from small_scenes import scene, slab

from softsim_core import Simulation
from softsim_core.base import Array, SceneError
from softsim_core.physics.actuation import Placed, Surroundings
from softsim_core.physics.actuation.chamber import Chamber, ChamberDescription
from softsim_core.physics.dynamics import on_nodes
from softsim_core.physics.mesh import TetMesh, boundary_faces, box_mesh, cavities, encloses, quadratic
from softsim_core.scene import BodyDescription, JointDescription, MaterialDescription, SceneDescription
from softsim_core.scene.building import build

SIDE, CELL = 0.04, 0.01


def hollow(order: int = 1) -> TetMesh:
    """A cube of 40 mm around a hollow cube of 20 mm."""
    whole = box_mesh((SIDE,) * 3, (4, 4, 4), (-0.5 * SIDE,) * 3)
    inside = (np.abs(whole.points[whole.tets].mean(axis=1)) < CELL).all(axis=1)
    used, tets = np.unique(whole.tets[~inside], return_inverse=True)
    mesh = TetMesh(whole.points[used], tets.reshape(-1, 4))
    return quadratic(mesh) if order == 2 else mesh


def inflated(
    mesh: TetMesh, control: str = "pressure", dt: float = 0.01, backend: str = "auto", **fields: Any
) -> SceneDescription:
    """A body that is held at its left side, and its chamber."""
    rubber = MaterialDescription(law="stable_neo_hookean", young_modulus=1e5, poisson_ratio=0.45)
    body = BodyDescription(name="body", mesh=mesh, material=rubber, density=1000.0)
    chamber = ChamberDescription(body="body", control=control, **fields)  # type: ignore[arg-type]
    described = scene(
        body,
        joints=(JointDescription(name="air", kind="chamber", actuator=chamber),),
        attachments=(slab("wall", "world", -0.5 * SIDE),),
        gravity=(0.0, 0.0, 0.0),
        rayleigh_mass=20.0,
        dt=dt,
    )
    return replace(described, solver=replace(described.solver, backend=backend))  # type: ignore[arg-type]


def chamber_of(mesh: TetMesh) -> tuple[Chamber, Any]:
    built = build(inflated(mesh))
    around = Surroundings(built.model, {"body": built.bodies[0].mesh}, {"body": 0})
    return Chamber(Placed("air", 0, ChamberDescription(body="body")), around), built.model


def shaken(state: Any, seed: int) -> None:
    state.positions += np.random.default_rng(seed).normal(0.0, 0.001, state.positions.shape)


@pytest.mark.parametrize("order", [1, 2])
def test_a_hollow_cube_has_its_volume_wherever_it_is(order: int) -> None:
    chamber, model = chamber_of(hollow(order))
    assert chamber.rest_volume == pytest.approx(8.0 * CELL**3)
    state = model.rest_state()
    state.positions[:] = 1.1 * state.positions + [3.0, -2.0, 1.0]
    assert chamber.value(model, state) == pytest.approx((1.1**3 - 1.0) * 8.0 * CELL**3)


@pytest.mark.parametrize("order", [1, 2])
def test_row_and_stiffness_are_derivatives_of_the_volume(order: int) -> None:
    """By central differences, on a crumpled wall; the stiffness of a closed hollow is symmetric."""
    chamber, model = chamber_of(hollow(order))
    state, rng = model.rest_state(), np.random.default_rng(3)
    shaken(state, 1)
    for _ in range(4):
        way, step = rng.normal(size=state.positions.shape), 1e-6
        ends = []
        for sign in (1.0, -1.0):
            other = model.empty_state()
            other.copy_from(state)
            other.positions += sign * step * way
            ends.append((chamber.value(model, other), spread(chamber, model, other)))
        slope = (ends[0][0] - ends[1][0]) / (2.0 * step)
        assert (spread(chamber, model, state) * way).sum() == pytest.approx(slope, rel=1e-6)
        turned = (ends[0][1] - ends[1][1]) / (2.0 * step)
        stiffness = on_nodes(model, chamber.geometric_stiffness(model, state, 700.0))
        np.testing.assert_allclose(
            stiffness @ way.ravel(), -700.0 * turned.ravel(), atol=1e-6 * np.abs(700.0 * turned).max()
        )
        assert sp.linalg.norm(stiffness - stiffness.T) < 1e-12 * sp.linalg.norm(stiffness)


def spread(chamber: Chamber, model: Any, state: Any) -> Array:
    result = np.zeros_like(state.positions)
    result[chamber.place] = chamber.row(model, state)
    return result


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("backend", ["scipy", pytest.param("numba", marks=pytest.mark.numba)])
def test_pressure_and_volume_control_agree(order: int, backend: str) -> None:
    if backend == "numba":
        pytest.importorskip("numba")
    by_volume = Simulation(inflated(hollow(order), "volume", backend=backend))
    solution = by_volume.settle([1.5e-6])
    pressure = float(solution.state.joint_efforts[0])
    assert pressure > 1e3
    assert by_volume.joint_positions[0] == pytest.approx(1.5e-6, rel=1e-6)
    by_pressure = Simulation(inflated(hollow(order), "pressure", backend=backend))
    by_pressure.settle([pressure])
    np.testing.assert_allclose(by_pressure.positions, by_volume.positions, atol=1e-8)
    assert by_pressure.joint_positions[0] == pytest.approx(1.5e-6, rel=1e-6)


@pytest.mark.slow
def test_rest_does_not_depend_on_the_step() -> None:
    ends = []
    for dt in (0.002, 0.01):
        simulation = Simulation(inflated(hollow(2), "pressure", dt))
        simulation.command([4e3])
        for _ in range(round(1.2 / dt)):
            simulation.step()
        ends.append(simulation.positions.copy())
    assert max(np.abs(end - ends[0]).max() for end in ends[1:]) < 1e-6
    np.testing.assert_allclose(
        ends[0], Simulation(inflated(hollow(2))).settle([4e3]).state.positions, atol=1e-6
    )


def test_limits_and_the_line_take_their_share() -> None:
    limited = Simulation(inflated(hollow(), "volume", max_pressure=2e3))
    limited.settle([4e-6])
    assert limited.joint_efforts[0] == pytest.approx(2e3)
    assert limited.joint_positions[0] < 2e-6
    soft = Simulation(inflated(hollow(), "volume", line_compliance=1e-10))
    soft.settle([1e-6])
    taken = 1e-10 * soft.joint_efforts[0]
    assert taken > 1e-8
    assert soft.joint_positions[0] == pytest.approx(1e-6 - taken, rel=1e-6)
    pulled = Simulation(inflated(hollow(), "pressure", min_pressure=-1e3))
    pulled.settle([-5e3])
    assert pulled.joint_efforts[0] == pytest.approx(-1e3)
    assert pulled.joint_positions[0] < -1e-8


def balloon(inner: float, outer: float) -> TetMesh:
    """A thick sphere of 80 faces: quadratic cells, all nodes on their spheres."""
    golden = 0.5 * (1.0 + 5.0**0.5)
    corners = [(0.0, s, t * golden) for s in (-1.0, 1.0) for t in (-1.0, 1.0)]
    points = np.array([np.roll(corner, k) for k in range(3) for corner in corners])
    faces = ConvexHull(points).simplices
    edges = np.unique(np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    points = np.concatenate([points, points[edges].mean(axis=1)])
    points /= np.linalg.norm(points, axis=1)[:, None]
    faces = ConvexHull(points).simplices
    layers, count = (inner, 0.5 * (inner + outer), outer), len(points)
    tets = []
    for low in range(2):
        for face in np.sort(faces, axis=1) + low * count:  # prisms, cut alike on both sides of each wall
            (a, b, c), (d, e, f) = face, face + count
            tets += [(a, b, c, f), (a, b, e, f), (a, d, e, f)]
    mesh = quadratic(TetMesh(np.concatenate([radius * points for radius in layers]), np.array(tets)))
    radii = np.linalg.norm(mesh.points[: 3 * count], axis=1)
    ends = np.concatenate([radii, np.zeros(len(mesh.points) - 3 * count)])
    for cell in mesh.tets:
        for k, (i, j) in enumerate(((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))):
            ends[cell[4 + k]] = 0.5 * (radii[cell[i]] + radii[cell[j]])
    return TetMesh(mesh.points * (ends / np.linalg.norm(mesh.points, axis=1))[:, None], mesh.tets)


@pytest.mark.slow
def test_a_balloon_follows_its_curve_through_its_maximum() -> None:
    """Pressure of a thick sphere of incompressible neo-Hookean rubber, filled slowly with water.

    p / 2 mu = 1 / b + 1 / 4 b^4 - 1 / a - 1 / 4 a^4, a and b the stretches of the inner and the outer side.
    """
    inner, outer, shear = 0.01, 0.013, 2e4
    mesh = balloon(inner, outer)
    rubber = MaterialDescription(law="yeoh", c1=0.5 * shear, poisson_ratio=0.499)
    body = BodyDescription(name="body", mesh=mesh, material=rubber, density=1000.0)
    water = ChamberDescription(body="body", control="volume")
    described = scene(
        body,
        joints=(JointDescription(name="water", kind="chamber", actuator=water),),
        gravity=(0.0, 0.0, 0.0),
        rayleigh_mass=40.0,
        dt=0.02,
    )
    simulation, seen = Simulation(described), []
    volume = 4.0 / 3.0 * np.pi * inner**3
    for stretch in np.linspace(1.0, 2.6, 200)[1:]:
        simulation.command([(stretch**3 - 1.0) * volume])
        simulation.step()
        wide = (outer**3 + (stretch**3 - 1.0) * inner**3) ** (1.0 / 3.0) / outer
        curve = 1.0 / wide + 0.25 / wide**4 - 1.0 / stretch - 0.25 / stretch**4
        seen.append((stretch, simulation.joint_efforts[0], 2.0 * shear * curve))
    table = np.array(seen)
    later = table[table[:, 0] > 1.15]
    assert 0 < np.argmax(later[:, 2]) < len(later) - 25  # over the top, and far beyond
    assert np.abs(later[:, 1] / later[:, 2] - 1.0).max() < 0.02


def test_hollows_are_found_and_told_apart() -> None:
    mesh = hollow(2)
    (only,) = cavities(mesh)
    assert only.shape == (48, 6)
    assert boundary_faces(mesh).shape == (48 + 192, 6)
    assert encloses(mesh.points, only, np.zeros(3))
    assert not encloses(mesh.points, only, np.array([0.015, 0.0, 0.0]))
    assert cavities(box_mesh((0.1, 0.1, 0.1), (2, 2, 2))) == []


@pytest.mark.parametrize(
    ("mesh", "fields", "sentence"),
    [
        (box_mesh((0.04,) * 3, (2, 2, 2), (-0.02,) * 3), {}, "body body encloses no hollow"),
        (
            hollow(),
            {"inside": (0.015, 0.0, 0.0)},
            "lies in no hollow of body body; the middles of its hollows are",
        ),
        (hollow(), {"min_pressure": 5.0}, "a range in Pa with 0 in it"),
        (hollow(), {"line_compliance": -1.0}, "line_compliance must be >= 0"),
    ],
)
def test_chambers_that_cannot_be_are_refused(mesh: TetMesh, fields: dict[str, Any], sentence: str) -> None:
    with pytest.raises(SceneError, match=sentence):
        Simulation(inflated(mesh, **fields))


def test_a_step_tells_what_it_did_without(backend: str) -> None:
    """Half of Young's modulus within one step: first what presses is left out, then cells are clamped."""
    described = inflated(hollow(2), backend=backend)
    described = replace(described, solver=replace(described.solver, substeps=1, rayleigh_mass=0.0))
    simulation, told = Simulation(described), []
    simulation.command([5e4])
    for _ in range(6):
        simulation.step()
        told.append(simulation.report.fallback)
    assert told == [0, 1, 1, 1, 2, 2]
