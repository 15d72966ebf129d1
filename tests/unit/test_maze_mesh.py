"""The maze plate: closed, of the wanted size, solvable, and one sentence for each wrong picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from softsim_core.base import MeshError
from softsim_core.physics.mesh import enclosed_volume, is_closed, read_surface
from softsim_core.robots import maze_mesh, maze_plate

MESHES = Path(__file__).resolve().parents[2] / "configs" / "meshes"
PICTURE = (MESHES / "maze.txt").read_text()


def test_closed_and_of_the_wanted_size() -> None:
    plate = maze_plate(PICTURE)
    assert is_closed(plate.triangles)
    np.testing.assert_allclose(
        plate.points.min(axis=0), [-maze_mesh.EDGE / 2, -maze_mesh.EDGE / 2, maze_mesh.UNDERSIDE], atol=1e-12
    )
    np.testing.assert_allclose(
        plate.points.max(axis=0), [maze_mesh.EDGE / 2, maze_mesh.EDGE / 2, maze_mesh.TOP], atol=1e-12
    )
    widths = np.diff(maze_mesh.grid_lines(len(PICTURE.split())))
    walls = maze_mesh.read_picture(PICTURE)
    area = float((walls * np.outer(widths, widths)).sum())
    expected = maze_mesh.EDGE**2 * -maze_mesh.UNDERSIDE + area * maze_mesh.TOP
    assert enclosed_volume(plate.points, plate.triangles) == pytest.approx(expected, rel=1e-9)
    np.testing.assert_allclose(widths[::2], maze_mesh.WALL)
    assert (widths[1::2] > 0.007).all()


def test_every_corridor_can_be_reached() -> None:
    walls = maze_mesh.read_picture(PICTURE)
    reached, border = {(1, 1)}, [(1, 1)]
    while border:
        i, j = border.pop()
        for cell in ((i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)):
            if not walls[cell] and cell not in reached:
                reached.add(cell)
                border.append(cell)
    assert len(reached) == (~walls).sum()


def test_committed_file_is_what_the_generator_writes(tmp_path: Path) -> None:
    assert maze_mesh.main(["--picture", str(MESHES / "maze.txt"), "--out", str(tmp_path / "maze.stl")]) == 0
    committed, fresh = read_surface(MESHES / "maze.stl"), read_surface(tmp_path / "maze.stl")
    np.testing.assert_array_equal(committed.triangles, fresh.triangles)
    np.testing.assert_allclose(committed.points, fresh.points, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("picture", "sentence"),
    [
        ("##\n##", "odd number of lines >= 3, not 2"),
        ("###\n#.#\n##", "line 3: needs 3 of # and ., not '##'"),
        ("###\n#x#\n###", "line 2: needs 3 of # and ."),
        ("###\n#..\n###", "walls all around"),
        ("#####\n#.#.#\n#.#.#\n#...#\n#####", None),
        ("#####\n#.#.#\n##..#\n#...#\n#####", "lines 2 and 3: walls touch at a corner only"),
    ],
)
def test_pictures(picture: str, sentence: str | None) -> None:
    if sentence is None:
        assert is_closed(maze_plate(picture).triangles)
        return
    with pytest.raises(MeshError, match=sentence):
        maze_plate(picture)
