"""`softsim mesh`: what it prints, writes and refuses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from part_surfaces import ball, box, inside_out, joined, moved, sheet, write

from softsim_core.lab.meshing import end_face, have_mesher
from softsim_core.physics.mesh import box_mesh, read_tets
from softsim_ros.cli import main
from softsim_ros.cli.robots import clamped_part, fitness

mesher = pytest.mark.skipif(
    not have_mesher(), reason="pytetwild is not installed (pip install 'softsim[mesh]')"
)


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)


@mesher
@pytest.mark.slow
def test_a_hollow_cube_in_inches(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """1 inch with a hollow of 0.3: its volume in closed form, its report as text and as JSON, both files."""
    hollow = joined(box(1, 1, 1), inside_out(ball(0.3)))
    part = write(tmp_path, hollow)
    words = ["mesh", str(part), "--unit", "in", "--size", "0.3", "--no-speed"]
    assert main([*words, "--out", "a.vtk", "--out", "b.msh", "--picture", "c.png"]) == 0
    shown = capsys.readouterr()
    assert "1 hollow inside" in shown.out
    assert "1 x 1 x 1 in" in shown.out
    assert "filling with edges of 0.3 in" in shown.err
    assert {file.name for file in tmp_path.iterdir()} == {"part.stl", "a.vtk", "b.msh", "c.png", "cache"}
    assert (tmp_path / "c.png").stat().st_size > 10_000
    mesh, other = read_tets(tmp_path / "a.vtk"), read_tets(tmp_path / "b.msh")
    assert np.array_equal(mesh.points, other.points)
    assert np.array_equal(mesh.tets, other.tets)
    assert main([*words, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["from_cache"]
    assert told["files"] == ["part.vtk"]
    assert (tmp_path / "part.vtk").read_bytes() == (tmp_path / "a.vtk").read_bytes()
    assert (told["nodes"], told["elements"], told["cavities"]) == (len(mesh.points), len(mesh.tets), 1)
    ball_volume = np.linalg.det(ball(0.3)[0][ball(0.3)[1]]).sum() / 6.0
    assert told["volume_m3"] == pytest.approx((1.0 - ball_volume) * 0.0254**3, rel=2e-3)
    assert told["largest_distance_m"] < 2e-3 * np.sqrt(3.0) * 0.0254
    assert np.ptp(mesh.points, axis=0) == pytest.approx(np.full(3, 0.0254), rel=3e-3)


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["sheet.stl"], 1, "mesh sheet.stl: is open: a hole of 28.35 mm across"),
        (["two.stl"], 1, "holds 2 bodies"),
        (["none.stl"], 1, "does not exist"),
        (["sheet.stl", "--size", "-1"], 1, "--size must be a number > 0, not -1"),
        (["sheet.stl", "--deviation", "nan"], 1, "--deviation must be a number > 0"),
        (["sheet.stl", "--out", "a.stl"], 2, "--out a.stl must end in .vtk or .msh"),
    ],
)
def test_refusals_are_one_sentence(
    words: list[str], code: int, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path, sheet(), "sheet.stl")
    write(tmp_path, joined(box(), moved(box(), 30.0)), "two.stl")
    assert main(["mesh", *words]) == code
    error = capsys.readouterr().err
    assert said in error
    assert error.splitlines()[-1].startswith("softsim")
    assert sorted(file.name for file in tmp_path.iterdir()) == ["sheet.stl", "two.stl"]


def test_size_and_nodes_exclude_each_other(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["mesh", "a.stl", "--size", "1", "--nodes", "5"])
    assert end.value.code == 2
    assert "not allowed with" in capsys.readouterr().err


def test_what_a_mesh_is_fit_for() -> None:
    assert "real time needs dt >= 10 ms" in fitness(7.9e-3)
    assert "real time needs dt >= 20 ms" in fitness(8.1e-3)
    assert "too slow for real time" in fitness(0.1)


def test_a_part_is_held_by_an_area_and_not_by_a_tip() -> None:
    """A bar that stands on an edge: so thick a slab that more than the edge's nodes are in it."""
    bar = box_mesh((0.02, 0.02, 0.1), (4, 4, 20))
    face = end_face(bar.points)
    inside = np.abs(bar.points - face.center) <= 0.5 * np.array(face.size)
    assert inside.all(axis=1).sum() == 25
    turned = bar.points @ np.array([[0.8, 0.0, -0.6], [0.0, 1.0, 0.0], [0.6, 0.0, 0.8]]).T
    face = end_face(turned)
    held = turned[(np.abs(turned - face.center) <= 0.5 * np.array(face.size)).all(axis=1)]
    assert np.linalg.matrix_rank(held - held.mean(axis=0), tol=1e-4) >= 2
    assert held[:, 2].max() - turned[:, 2].min() < 0.2 * np.ptp(turned[:, 2])
    assert clamped_part(bar).bodies[0].density == 1070.0
