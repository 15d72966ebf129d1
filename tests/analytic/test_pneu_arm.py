"""The pneumatic arm: its mesh, its threefold symmetry, inverse control."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

from softsim_core import InverseController, Simulation, load_scene
from softsim_core.base import MeshError
from softsim_core.physics.fem.elements import element, rest_quadrature
from softsim_core.physics.mechanics import rotation_exp
from softsim_core.physics.mesh import cavities, check_tets
from softsim_core.robots import ArmShape, pneu_arm, pneu_arm_mesh

MESH = Path(__file__).resolve().parents[2] / "configs" / "meshes" / "pneu_arm.vtk"


@pytest.mark.parametrize(
    "given", [{}, {"chambers": 4, "bore": 0.002}, {"chambers": 6, "rib": 0.002, "across": 1}]
)
def test_the_mesh_is_round_and_encloses_its_chambers(given: dict[str, Any]) -> None:
    shape = ArmShape(**given)
    mesh = pneu_arm(shape)
    assert mesh.order == 2
    hollows = cavities(mesh)
    assert len(hollows) == shape.chambers
    outside = np.linalg.norm(mesh.points[:, :2], axis=1).max()
    assert outside == pytest.approx(shape.radius)
    weights, _ = rest_quadrature(element("tet10"), mesh.points[mesh.tets])

    def width(radius: float) -> float:
        return 2.0 * radius * (np.pi / shape.chambers - np.arcsin(0.5 * shape.rib / radius))

    section = shape.chambers * quad(width, shape.tube, shape.radius - shape.wall)[0]
    hollow = section * (shape.length - shape.base_cap - shape.tip_cap)
    solid = np.pi * (shape.radius**2 - shape.bore**2) * shape.length
    assert weights.sum() == pytest.approx(solid - hollow, rel=0.02)


def test_the_meshes_are_the_generated_ones_and_the_robots_has_no_slivers(tmp_path: Path) -> None:
    assert pneu_arm_mesh.main(["--out", str(tmp_path)]) == 0
    for name in ("pneu_arm.vtk", "pneu_arm.stl", "pneumatic_arm.vtk", "pneumatic_arm.stl"):
        assert (tmp_path / name).read_bytes() == MESH.with_name(name).read_bytes()
    assert not check_tets(pneu_arm()).warnings


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"chambers": 1}, "chambers must be 2 to 6"),
        ({"tube": 0.02}, "from inside out"),
        ({"tip_cap": 0.0}, "the rest > 0"),
        ({"rib": 0.009}, "leave no room"),
    ],
)
def test_arms_that_cannot_be_are_refused(given: dict[str, Any], sentence: str) -> None:
    with pytest.raises(MeshError, match=sentence):
        ArmShape(**given)


def tip_with(volumes: tuple[float, ...]) -> np.ndarray:
    simulation = Simulation(load_scene("pneu_arm"))
    simulation.settle(volumes)
    pose = simulation.effector_pose
    assert pose is not None
    return pose.position


@pytest.mark.slow
@pytest.mark.exhaustive
def test_chambers_bend_it_away_from_them_and_alike() -> None:
    turn = rotation_exp(np.array([0.0, 0.0, 2.0 * np.pi / 3.0]))
    first, second = tip_with((6e-6, 0.0, 0.0)), tip_with((0.0, 6e-6, 0.0))
    assert first[0] < -7e-3
    assert abs(first[1]) < 5e-4
    np.testing.assert_allclose(np.linalg.norm(second - turn @ first), 0.0, atol=2e-5)


@pytest.mark.slow
def test_a_place_of_the_tip_is_reached_by_three_volumes() -> None:
    pytest.importorskip("daqp")
    robot = load_scene("pneu_arm")
    there = Simulation(robot)
    there.settle((5e-6, 2e-6, 1e-6))
    goal = there.effector_pose
    assert goal is not None
    controller = InverseController(robot)
    controller.start([1e-6, 1e-6, 1e-6], 0.0)
    controller.set_goal(goal)
    for _ in range(60):
        report = controller.tick()
        if report.status == "reached":
            break
    assert report.residual_m < 2e-4
