"""The shipped tentacle is the one of its generator, and has the published measures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from softsim_core import Simulation, load_scene
from softsim_core.physics.mesh import check_tets, read_tets
from softsim_core.robots import tentacle, tentacle_mesh

MESHES = Path(__file__).parents[2] / "configs" / "meshes"


def test_the_shipped_mesh_is_the_one_that_is_generated(tmp_path: Path) -> None:
    assert tentacle_mesh.main(["--out", str(tmp_path)]) == 0
    for name in ("tentacle.vtk", "tentacle.stl"):
        assert (tmp_path / name).read_bytes() == (MESHES / name).read_bytes()


def test_its_sections_are_round_and_its_volume_that_of_two_cones() -> None:
    mesh = tentacle()
    report = check_tets(mesh)
    r0, r1, r2 = 0.01541, 0.00642, 0.0048
    cones = sum(np.pi / 3.0 * h * (a * a + a * b + b * b) for h, a, b in ((0.305, r0, r1), (0.055, r1, r2)))
    assert report.warnings == ()
    assert report.volume == pytest.approx(cones, rel=0.05)  # the middles of edges are on the circles
    assert report.volume < cones
    rim = np.hypot(mesh.points[:, 0], mesh.points[:, 1])
    for along in tentacle_mesh.SECTIONS:
        section = np.abs(mesh.points[:, 2] + along) < 1e-12
        radius = np.interp(along, [0.0, 0.305, 0.36], [r0, r1, r2])
        assert rim[section].max() == pytest.approx(radius)
        assert np.isclose(rim[section], radius).sum() == 16


def test_its_tendons_are_where_they_were_measured() -> None:
    """At 30 and 150 degrees around the axis, 11.4 mm - 0.0295 s from it."""
    along = np.linspace(0.0, 0.305, 24)
    off = 0.0114 - 0.0295 * along
    tendons = Simulation(load_scene("tentacle"), "scipy").actuators
    for tendon, angle in zip(tendons, np.radians([30.0, 150.0]), strict=True):
        expected = np.stack([off * np.sin(angle), off * np.cos(angle), -along], axis=1)
        np.testing.assert_allclose(tendon.points, expected, atol=1e-6)


def test_it_has_the_order_of_its_file() -> None:
    assert read_tets(MESHES / "tentacle.vtk").order == 2
