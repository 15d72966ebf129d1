"""Chambers of named surfaces: physical groups of Gmsh files, and hollows that end at a fixed plate."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from test_chambers import CELL, SIDE, hollow, inflated

from softsim_core import Simulation
from softsim_core.base import Array, Box, IndexArray, SceneError
from softsim_core.physics.mesh import TetMesh, boundary_faces, box_mesh, cavities, quadratic, read_tets


def without(mesh: TetMesh, low: tuple[float, ...], high: tuple[float, ...]) -> TetMesh:
    """A mesh less the cells whose middle lies between two corners."""
    middles = mesh.points[mesh.tets].mean(axis=1)
    inside = ((middles > low) & (middles < high)).all(axis=1)
    used, tets = np.unique(mesh.tets[~inside], return_inverse=True)
    return TetMesh(mesh.points[used], tets.reshape(-1, 4))


HOLE = ((-SIDE, -CELL, -CELL), (CELL, CELL, CELL))


def pierced(order: int = 1) -> TetMesh:
    """A cube with a square hole that goes in from its left side, with the walls of the hole as a surface."""
    mesh = without(box_mesh((SIDE,) * 3, (4, 4, 4), (-0.5 * SIDE,) * 3), *HOLE)
    mesh = quadratic(mesh) if order == 2 else mesh
    faces = boundary_faces(mesh)
    outside = (np.abs(mesh.points[faces[:, :3]]) > 0.5 * SIDE - 1e-9).all(axis=1).any(axis=1)
    return replace(mesh, surfaces={"air": faces[~outside, :3]})


def plugged(order: int = 1) -> TetMesh:
    """The same with two more layers of cells at its left side, which close the hole."""
    mesh = box_mesh((1.5 * SIDE, SIDE, SIDE), (6, 4, 4), (-SIDE, -0.5 * SIDE, -0.5 * SIDE))
    mesh = without(mesh, (-0.5 * SIDE, *HOLE[0][1:]), HOLE[1])
    return quadratic(mesh) if order == 2 else mesh


def gmsh_file(path: Path, mesh: TetMesh, groups: dict[str, IndexArray], named: bool = True) -> Path:
    """A Gmsh file in which the faces of groups are physical ones, of number 11, 12 and so on."""
    kind = ("tetra10", "triangle6") if mesh.order == 2 else ("tetra", "triangle")
    tags = np.concatenate([np.full(len(faces), 11 + k) for k, faces in enumerate(groups.values())])
    physical = [np.full(len(mesh.tets), 3), tags]
    data = meshio.Mesh(
        mesh.points,
        [(kind[0], mesh.tets), (kind[1], np.concatenate(list(groups.values())))],
        cell_data={"gmsh:physical": physical, "gmsh:geometrical": physical},
    )
    if named:
        data.field_data = {name: np.array([11 + k, 2]) for k, name in enumerate(groups)}
        data.field_data["rubber"] = np.array([3, 3])
    meshio.write(path, data, file_format="gmsh22", binary=False)
    return path


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(("named", "name"), [(True, "hollow"), (False, "11")])
@pytest.mark.slow
def test_a_physical_group_is_the_chamber(tmp_path: Path, order: int, named: bool, name: str) -> None:
    """As all hollows of the body are, whichever way its triangles are turned."""
    mesh = hollow(order)
    (faces,) = cavities(mesh)
    outer = boundary_faces(mesh)
    faces[::2] = faces[::2][:, [0, 2, 1, 5, 4, 3][: faces.shape[1]]]
    read = read_tets(gmsh_file(tmp_path / "cube.msh", mesh, {"hollow": faces, "all": outer}, named))
    assert {key: len(value) for key, value in read.surfaces.items()} == (
        {"hollow": 48, "all": 240} if named else {"11": 48, "12": 240}
    )
    by_name = Simulation(inflated(read, "volume", surface=name)).settle([1.5e-6]).state
    everything = Simulation(inflated(mesh, "volume")).settle([1.5e-6]).state
    np.testing.assert_allclose(by_name.positions, everything.positions, atol=1e-10)
    np.testing.assert_allclose(by_name.joint_efforts, everything.joint_efforts, rtol=1e-9)


@pytest.mark.parametrize(("before", "after"), [(1, 2), (2, 1)])
def test_surfaces_stay_when_a_body_changes_its_order(tmp_path: Path, before: int, after: int) -> None:
    mesh = hollow(before)
    read = read_tets(gmsh_file(tmp_path / "cube.msh", mesh, {"hollow": cavities(mesh)[0]}))
    described = inflated(read, "volume", surface="hollow", line_volume=0.0)
    body = replace(described.bodies[0], order=after)
    simulation = Simulation(replace(described, bodies=(body,)))
    assert len(simulation.positions) == len(hollow(after).points)
    assert simulation.settle([1e-6]).state.joint_positions[0] > 1e-7


def two_hollows() -> TetMesh:
    mesh = box_mesh((2 * SIDE, SIDE, SIDE), (8, 4, 4), (-SIDE, -0.5 * SIDE, -0.5 * SIDE))
    for x in (-0.5 * SIDE, 0.5 * SIDE):
        mesh = without(mesh, (x - CELL, -CELL, -CELL), (x + CELL, CELL, CELL))
    one, other = cavities(mesh)
    return replace(mesh, surfaces={"one": one[:, :3], "both": np.concatenate([one, other])[:, :3]})


@pytest.mark.parametrize(("surface", "inside"), [("one", (-0.5 * SIDE, 0.0, 0.0)), ("both", None)])
def test_a_surface_is_one_hollow_or_several(surface: str, inside: Any) -> None:
    mesh, ends = two_hollows(), []
    for given in ({"surface": surface}, {"inside": inside}):
        simulation = Simulation(inflated(mesh, "pressure", **given))
        described = replace(
            simulation.scene.attachments[0], box=Box(center=(-SIDE, 0.0, 0.0), size=(1e-4, 1.0, 1.0))
        )
        simulation = Simulation(replace(simulation.scene, attachments=(described,)))
        ends.append(simulation.settle([2e3]).state)
    np.testing.assert_allclose(ends[0].positions, ends[1].positions, atol=1e-12)


def at(points: Array, wanted: Array) -> IndexArray:
    """Nodes at given places."""
    distance = np.abs(points[None] - wanted[:, None]).sum(axis=2)
    assert distance.min(axis=1).max() < 1e-9
    return np.asarray(distance.argmin(axis=1))


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(
    ("control", "given", "fields"),
    [("pressure", 3e3, {}), ("volume", 1.5e-6, {}), ("volume", 3e-6, {"line_volume": 1e-6})],
)
@pytest.mark.slow
def test_a_hollow_that_ends_at_a_plate_is_as_one_that_cells_close(
    order: int, control: str, given: float, fields: dict[str, Any]
) -> None:
    """Cells that do not move are a plate: the same shapes, volumes (also at rest: of air) and pressures."""
    described = inflated(plugged(order), control, **fields)
    block = Box(center=(-0.75 * SIDE, 0.0, 0.0), size=(0.5 * SIDE + 1e-6, 1.0, 1.0))
    wall = replace(described.attachments[0], box=block)
    closed = Simulation(replace(described, attachments=(wall,)))
    open_ended = Simulation(inflated(pierced(order), control, surface="air", **fields))
    ends = [simulation.settle([given]).state for simulation in (closed, open_ended)]
    same = at(closed.model.rest, open_ended.model.rest)
    assert np.abs(ends[1].positions - open_ended.model.rest).max() > 5e-4
    np.testing.assert_allclose(ends[1].positions, ends[0].positions[same], atol=1e-9)
    np.testing.assert_allclose(ends[1].joint_positions, ends[0].joint_positions, rtol=1e-6)
    np.testing.assert_allclose(ends[1].joint_efforts, ends[0].joint_efforts, rtol=1e-6)
    for simulation in (closed, open_ended):
        simulation.command([0.0])
        for _ in range(5):
            simulation.step()
    np.testing.assert_allclose(open_ended.positions, closed.positions[same], atol=1e-8)


def surface_of(mesh: TetMesh, faces: IndexArray) -> TetMesh:
    return replace(mesh, surfaces={"air": faces})


@pytest.mark.parametrize(
    ("mesh", "fields", "sentence"),
    [
        (hollow(), {"surface": "air"}, "no surface 'air': its mesh names none; name a physical group"),
        (pierced(), {"surface": "water"}, "no surface 'water': its surfaces are air"),
        (pierced(), {"surface": "air", "inside": (0.0, 0.0, 0.0)}, "at most one of inside and surface"),
        (
            surface_of(hollow(), cavities(hollow())[0][1:]),
            {"surface": "air"},
            "is open, at 3 edges that are not attached to the world .one at",
        ),
        (surface_of(hollow(), hollow().tets[:5, :3]), {"surface": "air"}, "are no boundary of body body"),
        (
            surface_of(
                hollow(),
                boundary_faces(hollow())[
                    np.abs(hollow().points[boundary_faces(hollow())]).max(axis=(1, 2)) > 0.015
                ],
            ),
            {"surface": "air"},
            "goes around body body from outside",
        ),
    ],
)
def test_surfaces_that_are_no_chamber_are_refused(
    mesh: TetMesh, fields: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(SceneError, match=sentence):
        Simulation(inflated(mesh, **fields))


def test_a_rim_that_is_not_flat_is_refused() -> None:
    mesh = pierced()
    rim = (np.abs(mesh.points[:, 0] + 0.5 * SIDE) < 1e-9) & (np.abs(mesh.points[:, 1:]) < 1.5 * CELL).all(
        axis=1
    )
    bent = mesh.points.copy()
    bent[rim, 0] += 20.0 * bent[rim, 1] * bent[rim, 2]
    described = inflated(replace(mesh, points=bent), surface="air")
    wall = replace(described.attachments[0], box=Box(center=(-0.5 * SIDE, 0.0, 0.0), size=(0.008, 1.0, 1.0)))
    with pytest.raises(SceneError, match="is not flat, and no plate closes it"):
        Simulation(replace(described, attachments=(wall,)))
