"""Many settings at once: a tilted hollow cube of quadratic cells falls, is inflated, and comes to rest.

Yeoh's rubber with Prony terms, a chamber, the second-order step and contact with friction together.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from contact_scenes import DISTANCE, FLOOR, GRAVITY, touching
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from softsim_core import Simulation
from softsim_core.base import Array, Sphere
from softsim_core.physics.actuation.chamber import ChamberDescription
from softsim_core.physics.mechanics import JointLimits, rotation_exp
from softsim_core.physics.mesh import TetMesh, box_mesh, quadratic
from softsim_core.scene import (
    AttachmentDescription,
    BodyDescription,
    JointDescription,
    MaterialDescription,
    SceneDescription,
)

SIDE, CELLS = 0.03, 3
PRESSURE = 6e3
DENSITY = 1000.0
TOLERANCE = 1e-10
"""Of the contacts in [m]; an error of each step shakes a body that lies by a hundred times as much."""
TOUCHES, COMPARED, INFLATES, SETTLES = 10, 8, 30, 160
"""Steps until it touches, that both paths do from there, until it is told its pressure, and after that."""
RUBBER = MaterialDescription(law="yeoh", c1=2e4, c2=1e3, poisson_ratio=0.49, prony=((0.3, 0.05), (0.2, 0.1)))


def hollow() -> TetMesh:
    """A cube around its middle cell, about the origin."""
    whole = box_mesh((SIDE,) * 3, (CELLS,) * 3, (-0.5 * SIDE,) * 3)
    inside = (np.abs(whole.points[whole.tets].mean(axis=1)) < 0.5 * SIDE / CELLS).all(axis=1)
    used, tets = np.unique(whole.tets[~inside], return_inverse=True)
    return quadratic(TetMesh(whole.points[used], tets.reshape(-1, 4)))


def cube(points: Array, to: str, backend: str) -> SceneDescription:
    """The cube with its nodes at `points`; one corner is rigid, and free or held."""
    corner = points[np.abs(hollow().points - 0.5 * SIDE).sum(axis=1).argmin()]
    mesh = replace(hollow(), points=points)
    body = BodyDescription(name="cube", mesh=mesh, material=RUBBER, density=DENSITY)
    chamber = ChamberDescription(body="cube", control="pressure")
    described = touching(
        FLOOR,
        soft=(body,),
        joints=(
            JointDescription(
                name="air",
                kind="chamber",
                limits=JointLimits(lower=0.0, upper=1e4, speed=2e4),
                actuator=chamber,
            ),
        ),
        attachments=(
            AttachmentDescription(
                name="corner",
                body="cube",
                to=to,
                sphere=Sphere(center=tuple(corner.tolist()), radius=0.2 * SIDE),
            ),
        ),
        backend=backend,
    )
    if to == "world":
        described = replace(described, rigid_bodies=(), collisions=())
    contact = replace(described.contact, tolerance=TOLERANCE)
    solver = replace(described.solver, time_integration="bossak")
    return replace(described, contact=contact, solver=solver)


def tilted() -> Array:
    """The nodes, turned at random, 20 mm above the floor."""
    points = hollow().points @ rotation_exp(np.random.default_rng(12).uniform(-1.0, 1.0, 3)).T
    points[:, 2] += 0.02 - points[:, 2].min()
    return np.asarray(points)


@pytest.mark.slow
@pytest.mark.numba
def test_it_falls_is_inflated_and_rests_where_statics_say() -> None:
    pytest.importorskip("numba")
    points = tilted()
    simulation = Simulation(cube(points, "free", "numba"))
    for step in range(TOUCHES + INFLATES + SETTLES):
        if step == TOUCHES:
            start = simulation.snapshot()
        if step == TOUCHES + INFLATES:
            simulation.command([PRESSURE])
        simulation.step()
        assert simulation.contacts.residual < 1e-6
        assert simulation.contacts.gaps.min(initial=0.0) > -0.05 * DISTANCE
        if step == TOUCHES + COMPARED - 1:
            compiled = simulation.positions.copy()
    assert np.abs(simulation.velocities).max() < 2e-5
    weight = DENSITY * 26.0 / 27.0 * SIDE**3 * GRAVITY
    forces = on_nodes(simulation)
    assert np.abs(forces.sum(axis=0) - [0.0, 0.0, weight]).max() < 1e-4 * weight

    plain = Simulation(cube(points, "free", "scipy"))
    rest = plain.frames()["corner"]
    plain.restore(start)
    for _ in range(COMPARED):
        plain.step()
    assert len(plain.contacts.forces)
    assert np.abs(plain.positions - compiled).max() < 1e-9

    # The same cube held by its corner as it lies, with the floor's forces in the place of the floor.
    frame = simulation.frames()["corner"]
    turn = (
        Rotation.from_quat(frame.quaternion_xyzw) * Rotation.from_quat(rest.quaternion_xyzw).inv()
    ).as_matrix()
    held = Simulation(cube((points - rest.position) @ turn.T + frame.position, "world", "numba"))
    held.forces = forces
    static = held.equilibrium([PRESSURE])
    assert np.abs(static.state.positions - simulation.positions).max() < 5e-7


def on_nodes(simulation: Simulation) -> Array:
    """The floor's forces on the nodes of the cube in [N], shape (n, 3)."""
    report, (cube_surface, *_) = simulation.contacts, simulation.collision_surfaces
    _, node = KDTree(simulation.positions).query(simulation.collision_points[cube_surface.vertices])
    forces = np.zeros_like(simulation.positions)
    for force, pair, vertices, weights in zip(
        report.forces, report.pairs, report.vertices, report.weights, strict=True
    ):
        side = pair.tolist().index(0)
        own = slice(3 * side, 3 * side + 3)
        np.add.at(forces, node[vertices[own]], (1 - 2 * side) * weights[own, None] * force)
    return forces
