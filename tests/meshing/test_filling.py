"""Filling surfaces: the volume of closed forms, cavities, sizes, limits, and the same file every time."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from part_surfaces import (
    Surface,
    ball,
    box,
    inside_out,
    joined,
    moved,
    pinched_ring,
    rod,
    tilted,
    torus,
    volume,
    write,
)

from softsim_core.base import MeshError
from softsim_core.lab.meshing import (
    Filling,
    MeshingOptions,
    distances,
    fill_surface,
    have_mesher,
    largest_distance,
    mesh_part,
    with_nodes,
)
from softsim_core.physics.mesh import (
    SurfaceMesh,
    TetMesh,
    boundary_surface,
    box_mesh,
    cavities,
    read_tets,
    tet_volumes,
    write_surface,
    write_tets,
)

mesher = pytest.mark.skipif(
    not have_mesher(), reason="pytetwild is not installed (pip install 'softsim[mesh]')"
)
COARSE = MeshingOptions(size=6e-3)
CUBE = 8000.0


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "softsim" / "meshes"


def inside(places: np.ndarray, mesh: TetMesh) -> np.ndarray:
    """Which places (p, 3) lie in a tetrahedron, by barycentric coordinates."""
    origin = mesh.points[mesh.tets[:, 0]]
    edges = mesh.points[mesh.tets[:, 1:4]] - origin[:, None]
    shares = np.einsum("mij,pmi->pmj", np.linalg.inv(edges), places[:, None] - origin)
    return ((shares >= 0.0).all(axis=2) & (shares.sum(axis=2) <= 1.0)).any(axis=1)


def crossings_above(places: np.ndarray, surface: Surface) -> np.ndarray:
    """How many triangles a ray from each place along +z meets: odd inside a closed surface."""
    a, b, c = np.moveaxis(surface[0][surface[1]], 1, 0)
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    off = places[:, None] - a
    with np.errstate(all="ignore"):
        u = (off[..., 0] * (c - a)[:, 1] - off[..., 1] * (c - a)[:, 0]) / area
        v = ((b - a)[:, 0] * off[..., 1] - (b - a)[:, 1] * off[..., 0]) / area
        height = a[:, 2] + u * (b - a)[:, 2] + v * (c - a)[:, 2]
        return ((u >= 0) & (v >= 0) & (u + v <= 1) & (height > places[:, None, 2])).sum(axis=1)


BAR = rod(8.0, 30.0, 6)
BOXES = [box(), moved(tilted(box(), 10, 20, 30), 9, 8, 7)]
FILLED = {
    "torus": ([torus()], []),
    "hollow cube": ([box(24, 24, 24), inside_out(ball(6.0))], [1]),
    "two boxes that cross": (BOXES, []),
}


@mesher
@pytest.mark.parametrize("name", FILLED)
@pytest.mark.slow
def test_a_place_lies_in_the_mesh_where_rays_say_that_it_lies_in_the_part(name: str, tmp_path: Path) -> None:
    shells, hollow = FILLED[name]
    made = mesh_part(write(tmp_path, joined(*shells)), COARSE)
    assert made.report.min_dihedral_deg > 5.0
    assert made.report.inverted == 0
    assert len(cavities(made.mesh)) == made.source.cavities == len(hollow)
    low, high = made.mesh.points.min(axis=0), made.mesh.points.max(axis=0)
    places = np.random.default_rng(8).uniform(low, high, (400, 3))
    odd = [crossings_above(1e3 * places, shell) % 2 == 1 for shell in shells]
    expected = odd[0] & ~odd[1] if hollow else np.any(odd, axis=0)
    sure = distances(places, made.source.surface) > made.distance
    assert sure.sum() > 300
    assert np.array_equal(inside(places, made.mesh)[sure], expected[sure])
    error = made.volume_error
    assert (error is None) == (name == "two boxes that cross")
    if error is not None:
        assert abs(error) < 2e-3
        assert made.report.volume == pytest.approx(1e-9 * volume(joined(*shells)), rel=2e-3)


@mesher
@pytest.mark.slow
def test_the_same_file_and_options_give_the_same_bytes(tmp_path: Path, cache: Path) -> None:
    part = write(tmp_path, BAR)
    first = mesh_part(part, COARSE)
    elsewhere = write(tmp_path / "cache", BAR)
    again = mesh_part(elsewhere, replace(COARSE, time_limit=30.0))
    assert (first.from_cache, again.from_cache) == (False, True)
    one, other = (write_tets(tmp_path / f"{k}.vtk", made.mesh) for k, made in enumerate((first, again)))
    assert one.read_bytes() == other.read_bytes()
    assert replace(again.report, warnings=()) == replace(first.report, warnings=())
    # a mesh that has slivers, as one now and then does, tells of them by its file
    named = [each.replace(str(elsewhere), str(part)) for each in again.report.warnings]
    assert named == list(first.report.warnings)
    (kept,) = cache.glob("*.vtk")
    assert not mesh_part(part, replace(COARSE, size=9e-3)).from_cache
    kept.write_bytes(kept.read_bytes()[:500])  # a damaged one is made anew
    assert not mesh_part(part, COARSE).from_cache
    assert [file.name for file in cache.iterdir() if file.name.startswith(".")] == []


@mesher
@pytest.mark.slow
def test_without_a_cache_it_goes_on_and_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    made = mesh_part(write(tmp_path, box()), COARSE)
    assert "cache cannot be written" in made.remarks[-1]


@mesher
@pytest.mark.slow
def test_about_as_many_nodes_as_are_wished(tmp_path: Path) -> None:
    made = mesh_part(write(tmp_path, BAR), MeshingOptions(nodes=700))
    assert made.report.nodes == pytest.approx(700, rel=0.15)
    assert made.mesh.order == 1
    assert made.report.volume == pytest.approx(1e-9 * volume(BAR), rel=2e-3)


@mesher
@pytest.mark.slow
def test_edges_are_as_long_as_is_wished(tmp_path: Path) -> None:
    made = mesh_part(write(tmp_path, box()), MeshingOptions(size=5e-3, order=2))
    assert made.mesh.order == 2
    assert made.report.volume == pytest.approx(8e-6, rel=1e-3)
    assert made.report.mean_edge == pytest.approx(5e-3, rel=0.35)


def test_where_even_long_edges_leave_too_many_nodes_the_mesh_is_made_coarser(tmp_path: Path) -> None:
    asked = []

    def fill(surface: SurfaceMesh, edge: float, how: Filling) -> TetMesh:
        asked.append(how.coarsen)
        cells = 3 if how.coarsen else 6
        return box_mesh((0.02, 0.02, 0.02), (cells,) * 3, (-0.01, -0.01, -0.01))

    made = mesh_part(write(tmp_path, box()), MeshingOptions(nodes=60), fill=fill)
    assert made.report.nodes == 64
    assert asked[0] is False
    assert asked[-1] is True
    refined = mesh_part(write(tmp_path, box()), MeshingOptions(nodes=30), fill=fill)
    assert "64 nodes are the nearest to 30" in refined.remarks[-1]


@mesher
@pytest.mark.slow
def test_walls_thinner_than_the_deviation_are_not_lost_in_silence(tmp_path: Path) -> None:
    """A plate of 100 x 100 x 0.1 mm; a thousandth of its diagonal is more than its thickness."""
    part = write(tmp_path, box(100.0, 100.0, 0.1))
    with pytest.raises(MeshError, match="--deviation") as refusal:
        mesh_part(part, MeshingOptions(size=1e-2, time_limit=60.0))
    assert "\n" not in str(refusal.value)


@mesher
@pytest.mark.slow
def test_a_part_that_touches_itself_is_one_piece(tmp_path: Path) -> None:
    made = mesh_part(write(tmp_path, pinched_ring()), COARSE)
    assert made.report.volume == pytest.approx(7 * 125e-9, rel=5e-3)
    assert any("touches itself" in told for told in made.remarks)


def by(made: TetMesh):  # a mesher that makes this
    return lambda surface, edge, how: replace(made, name=surface.name)


@pytest.mark.parametrize(
    ("made", "word"),
    [
        (box_mesh((0.02, 0.02, 0.01), (2, 2, 2), (-0.01, -0.01, -0.01)), "deviates by 10 mm"),
        (box_mesh((0.02, 0.02, 0.02), (2, 2, 2), (-0.0101, -0.01, -0.01)), "deviates by 0.1 mm"),
    ],
)
def test_a_mesh_that_is_not_that_of_the_part_is_refused(made: TetMesh, word: str, tmp_path: Path) -> None:
    options = MeshingOptions(size=5e-3, deviation=2e-5)
    with pytest.raises(MeshError, match=word):
        mesh_part(write(tmp_path, box()), options, fill=by(made))


def test_a_mesh_in_pieces_is_refused(tmp_path: Path) -> None:
    half = box_mesh((0.01, 0.02, 0.02), (1, 2, 2), (-0.01, -0.01, -0.01))
    points = np.concatenate([half.points, half.points + np.array([0.01, 0.0, 0.0])])
    both = TetMesh(points, np.concatenate([half.tets, half.tets + len(half.points)]))
    with pytest.raises(MeshError, match="2 pieces"):
        mesh_part(write(tmp_path, box()), MeshingOptions(size=5e-3), fill=by(both))


SURFACE = SurfaceMesh(1e-3 * box()[0], box()[1], "a cube")
WRONG = {
    "import os; os.abort()": r"crashed \(SIGABRT\)",
    "import ctypes; ctypes.string_at(0)": r"crashed \(SIGSEGV\)",
    "raise MemoryError": "out of memory",
    "raise ValueError('no such thing')": "no such thing",
    "pass": "wrote no mesh",
    "import sys; open(sys.argv[2], 'w').write('x')": "wrote no mesh",
    "import time; time.sleep(600)": "stopped after 0.1 s",
    "import sys, numpy as n; n.savez(sys.argv[2], points=n.eye(3), tets=n.zeros((0, 4), int))": "nothing",
}


@pytest.mark.parametrize("code", WRONG)
def test_whatever_becomes_of_the_mesher_is_said_in_one_sentence(code: str) -> None:
    with pytest.raises(MeshError, match=WRONG[code]) as refusal:
        fill_surface(
            SURFACE, 5e-3, Filling(time_limit=0.1 if "sleep" in code else 60.0), (sys.executable, "-c", code)
        )
    assert "\n" not in str(refusal.value)


def test_a_mesher_that_works_for_long_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("softsim_core.lab.meshing.filling.WORD_S", 0.05)
    said: list[float] = []

    def waited(seconds: float) -> None:
        said.append(seconds)
        if len(said) == 3:
            raise KeyboardInterrupt  # who waits has seen enough, and the mesher ends

    with pytest.raises(KeyboardInterrupt):
        fill_surface(
            SURFACE,
            5e-3,
            Filling(time_limit=600.0, waited=waited),
            (sys.executable, "-c", "import time; time.sleep(600)"),
        )
    assert said == sorted(said)


@mesher
@pytest.mark.slow
def test_too_little_memory_is_said() -> None:
    with pytest.raises(MeshError, match=r"memory|crashed"):
        fill_surface(SURFACE, 2e-4, Filling(memory=200 << 20, time_limit=60.0))


def test_without_the_mesher_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("softsim_core.lab.meshing.filling.compiled_part", lambda: None)
    with pytest.raises(MeshError, match=r"pip install .*\[mesh\]'"):
        fill_surface(SURFACE, 5e-3, Filling())


@pytest.mark.parametrize(("walls", "inner"), [(0.0, 1.0), (1.0, 0.0), (0.5, 0.5)])
@pytest.mark.parametrize("nodes", [60, 1000, 20000])
def test_the_search_for_a_size_ends_near_it(walls: float, inner: float, nodes: int) -> None:
    """Nodes go with edge^-2 along walls and edge^-3 inside, and no mesh has fewer than 40."""

    def fill(edge: float) -> TetMesh:
        count = 40 + round(walls * (0.1 / edge) ** 2 + inner * (0.1 / edge) ** 3)
        return TetMesh(np.zeros((count, 3)), np.zeros((1, 4), dtype=np.int64))

    sized = with_nodes(fill, 1e-3, 1.0, nodes)
    assert len(sized.mesh.points) == pytest.approx(nodes, rel=0.15)
    assert sized.tries <= 6


@pytest.mark.parametrize(("nodes", "fills"), [(None, 1), (1000, 2)])
def test_a_number_of_nodes_that_nobody_asked_for_is_met_roughly(
    tmp_path: Path, nodes: int | None, fills: int
) -> None:
    """The first mesh has 729 nodes: near enough to the default of 1000, not to a wish of 1000."""
    cells: list[int] = []

    def fill(surface: SurfaceMesh, edge: float, how: Filling) -> TetMesh:
        cells.append(9 if cells else 8)
        return box_mesh((0.1, 0.1, 0.1), (cells[-1],) * 3, (0.0, 0.0, 0.0))

    write_surface(tmp_path / "cube.stl", boundary_surface(fill(SURFACE, 0.0, Filling())))
    cells.clear()
    made = mesh_part(tmp_path / "cube.stl", MeshingOptions(nodes=nodes, unit="m"), fill=fill)
    assert len(cells) == fills
    assert len(made.mesh.points) == (729 if nodes is None else 1000)


@pytest.mark.parametrize("longest", [0.05, 1.0])
def test_a_size_that_cannot_be_had_gives_the_nearest(longest: float) -> None:
    """A mesh with 500 nodes however long its edges are: it is not asked for longer ones for ever."""

    def fill(edge: float) -> TetMesh:
        assert edge <= longest
        return TetMesh(np.zeros((500, 3)), np.zeros((1, 4), dtype=np.int64))

    sized = with_nodes(fill, 1e-3, longest, 100)
    assert (len(sized.mesh.points), sized.tries) == (500, 2)


def test_a_try_that_fails_does_not_lose_the_meshes_before_it() -> None:
    """Longer edges make the mesher hang: the mesh with too many nodes is kept, and the first failure told."""

    def fill(edge: float) -> TetMesh:
        if edge > limit:
            raise MeshError("a part", "the mesher was stopped after 300 s")
        return TetMesh(np.zeros((500, 3)), np.zeros((1, 4), dtype=np.int64))

    limit = 0.03
    sized = with_nodes(fill, 1e-3, 0.05, 100)
    assert (len(sized.mesh.points), sized.tries) == (500, 1)
    limit = 0.0
    with pytest.raises(MeshError, match="was stopped after 300 s"):
        with_nodes(fill, 1e-3, 0.05, 100)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.slow
def test_distances_of_surfaces_in_closed_form(seed: int) -> None:
    """A sphere in a box: as far as the box's corners from the sphere, one way, and its faces, the other."""
    turned = np.random.default_rng(seed).uniform(-180.0, 180.0, 3)
    cube, sphere = (SurfaceMesh(*tilted(each, *turned)) for each in (box(), ball(8.0, 4)))
    assert largest_distance(cube, sphere)[0] == pytest.approx(10.0 * math.sqrt(3.0) - 8.0, rel=2e-3)
    assert largest_distance(sphere, cube)[0] == pytest.approx(10.0 - 8.0 / math.sqrt(3.0), rel=5e-3)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("suffix", [".vtk", ".msh"])
def test_what_is_written_is_read_again_to_the_last_bit(order: int, suffix: str, tmp_path: Path) -> None:
    from softsim_core.physics.mesh import quadratic

    mesh = box_mesh((0.1, 0.2, 1.0 / 3.0), (2, 1, 3))
    mesh = quadratic(mesh) if order == 2 else mesh
    again = read_tets(write_tets(tmp_path / f"mesh{suffix}", mesh))
    assert np.array_equal(again.points, mesh.points)
    assert np.array_equal(again.tets, mesh.tets)
    assert (tet_volumes(again.points, again.tets[:, :4]) > 0.0).all()
