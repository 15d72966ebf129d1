"""Hollows with an air inlet are found, with the place and the width of the inlet."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from part_surfaces import Surface, ball, bottle, box, inside_out, joined, moved, tilted, write

from softsim_core.lab.meshing import CELLS, MeshedPart, guess, open_hollows, read_part, repair_part
from softsim_core.physics.mesh import SurfaceMesh, box_mesh, check_tets, read_surface

PARTS = Path(__file__).resolve().parents[2] / "configs"


def in_metres(surface: Surface) -> SurfaceMesh:
    return SurfaceMesh(1e-3 * surface[0], surface[1], "part")


@pytest.mark.parametrize("inlet", [2.0, 3.0, 5.0, 8.0])
def test_a_hollow_with_an_inlet_is_found(inlet: float) -> None:
    (found,) = open_hollows(in_metres(bottle(inlet)))
    cell = 1e-3 * 60.0 / CELLS
    assert found.volume == pytest.approx(1e-9 * np.pi * 15.0**2 * 52.0, rel=0.06)
    assert found.width == pytest.approx(2e-3 * inlet, abs=1.5 * cell)
    assert np.linalg.norm(found.place[:2]) < 1e-3 * inlet
    assert 0.056 - cell <= found.place[2] <= 0.060 + cell


def test_it_is_found_however_the_part_lies() -> None:
    (found,) = open_hollows(in_metres(tilted(bottle(3.0), 20.0, -35.0, 50.0)))
    top = tilted((np.array([[0.0, 0.0, 58.0]]), np.zeros((0, 3), dtype=np.int64)), 20.0, -35.0, 50.0)[0][0]
    assert np.linalg.norm(found.place - 1e-3 * top) < 0.004


@pytest.mark.parametrize(
    "surface",
    [
        bottle(12.0),  # a cup
        box(12, 8, 60),
        joined(box(24, 24, 40), moved(inside_out(ball(9.0, 1)), z=5.0)),  # a closed hollow
    ],
)
def test_what_is_wide_open_or_closed_has_no_inlet(surface: Surface) -> None:
    assert open_hollows(in_metres(surface)) == ()


def test_the_shipped_parts_have_none() -> None:
    """Lattice, fin ray, bellows, pneumatic bodies, maze: grooves and windows are no inlets."""
    for file in sorted(PARTS.glob("*/*.stl")):
        assert open_hollows(read_surface(file)) == (), file.name


def test_the_inlet_is_named_in_the_unit_of_the_file(tmp_path: Path) -> None:
    pytest.importorskip("rclpy")
    from softsim_ros.cli.robots import inlet_notes

    (note,) = inlet_notes(repair_part(read_part(write(tmp_path, bottle(3.0)))))
    assert note.startswith("a hollow of about 36 cm^3 is open to the outside, about 5.8")
    assert "an air chamber needs a closed hollow" in note
    assert "make the robot again with --plug, or close the opening in CAD with a plug" in note


def test_the_scene_says_so_where_it_guesses_a_cable(tmp_path: Path) -> None:
    pytest.importorskip("rclpy")
    from softsim_ros.cli.robots import inlet_notes, scene_text

    source = repair_part(read_part(write(tmp_path, bottle(3.0))))
    mesh = box_mesh((0.04, 0.04, 0.06), (2, 2, 3))
    made = MeshedPart(mesh, source, check_tets(mesh), 0.01, 0.0, (), False)
    notes = inlet_notes(source)
    text = scene_text("pump", made, guess(mesh), "Ecoflex 00-30", 1.0, notes)
    assert f"joints:\n  # {notes[0]}\n  # GUESS: one cable" in text
    assert yaml.safe_load(text)["joints"][0]["name"] == "cable"
