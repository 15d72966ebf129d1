"""Openings of hollows are closed by plugs: then they are air chambers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from part_surfaces import Surface, bottle, box, joined, lattice, moved, tilted, write

from softsim_core.base import Array, MeshError
from softsim_core.lab.meshing import (
    MeshingOptions,
    RepairedSurface,
    have_mesher,
    mesh_part,
    open_hollows,
    read_part,
    repair_part,
    without_channel,
)
from softsim_core.physics.mesh import SurfaceMesh, TetMesh, box_mesh

SEGMENTS, INLET = 48, 3.0


def revolved(profile: list[tuple[float, float]], square: int = 0) -> Surface:
    """Rings of a radius and a height, closed at both ends; the first `square` ones are squares."""
    radii, heights = np.array(profile).T
    angles = 2.0 * np.pi * np.arange(SEGMENTS) / SEGMENTS
    wide = np.ones((len(radii), SEGMENTS))
    wide[:square] = 1.0 / np.maximum(np.abs(np.cos(angles)), np.abs(np.sin(angles)))
    x, y = (radii[:, None] * wide * each(angles) for each in (np.cos, np.sin))
    rings = np.stack([x, y, np.repeat(heights[:, None], SEGMENTS, axis=1)], axis=-1).reshape(-1, 3)
    first, last = np.arange(SEGMENTS), np.arange(SEGMENTS) + SEGMENTS * (len(radii) - 1)
    middles = np.full(SEGMENTS, len(rings)), np.full(SEGMENTS, len(rings) + 1)
    triangles = [
        lattice(SEGMENTS, len(radii), closed_columns=True),
        np.column_stack([np.roll(first, -1), first, middles[0]]),
        np.column_stack([last, np.roll(last, -1), middles[1]]),
    ]
    ends = [[0.0, 0.0, heights[0]], [0.0, 0.0, heights[-1]]]
    return np.vstack([rings, ends]), np.concatenate(triangles)


def box_with_inlet() -> Surface:
    """A square box, 60 mm high, with a cylindrical hollow of 28 mm and an inlet in its lid of 5 mm."""
    return revolved([(20, 0), (20, 60), (INLET, 60), (INLET, 55), (14, 55), (14, 5)], square=2)


def bellows_with_hose_hole() -> Surface:
    """Four folds with a wall of 3 mm, and a neck of 10 mm length for a hose."""
    outside = [(20.0 if k % 2 else 15.0, 6.0 * k) for k in range(9)]
    inside = [(17.0 if k % 2 else 12.0, 6.0 * k) for k in range(7, 0, -1)]
    neck = [(INLET + 3.0, 48.0), (INLET + 3.0, 58.0), (INLET, 58.0), (INLET, 45.0)]
    return revolved([*outside, *neck, *inside, (12.0, 3.0)])


PARTS = {
    "box": box_with_inlet(),
    "bellows": bellows_with_hose_hole(),
    "tilted bellows": tilted(bellows_with_hose_hole(), 20.0, -35.0, 50.0),
    "wide bottle": bottle(8.0),
    "narrow bottle": bottle(2.0),
}


def plugged(folder: Path, surface: Surface) -> tuple[RepairedSurface, RepairedSurface, float]:
    """A part before and after it was plugged, and the width of its opening in [m]."""
    part = read_part(write(folder, surface))
    before = repair_part(part)
    (opening,) = open_hollows(before.surface)
    cut = replace(part, surface=without_channel(before.surface, opening))
    return before, repair_part(cut, float("inf")), opening.width


@pytest.mark.slow
@pytest.mark.parametrize("name", PARTS)
def test_a_plug_closes_the_opening(name: str, tmp_path: Path) -> None:
    before, after, width = plugged(tmp_path, PARTS[name])
    assert (before.cavities, after.cavities, after.crosses) == (0, 1, False)
    assert open_hollows(after.surface) == ()
    radius = 0.5 * width
    assert 0.0 < after.volume - before.volume < 3.0 * np.pi * radius**2 * 2.0 * radius
    assert np.ptp(after.surface.points, axis=0) == pytest.approx(np.ptp(before.surface.points, axis=0))


@pytest.mark.slow
def test_only_the_channel_changes(tmp_path: Path) -> None:
    before, after, _ = plugged(tmp_path, PARTS["box"])

    def known(points: Array) -> set[tuple[float, ...]]:
        return {tuple(each) for each in points.round(9).tolist()}

    new = np.array(sorted(known(after.surface.points) - known(before.surface.points)))
    assert np.hypot(new[:, 0], new[:, 1]).max() < 1.05e-3 * INLET
    assert new[:, 2].min() > 0.0549
    assert new[:, 2].max() < 0.0601
    assert known(before.surface.points) <= known(after.surface.points)


def stand_in(surface: SurfaceMesh, edge: float, how: object) -> TetMesh:
    """No mesh of the part: the mesher's place is taken to see what it is given."""
    raise MeshError(surface.name, f"{len(surface.points)} points to fill")


@pytest.mark.slow
def test_the_option_says_what_it_plugs_and_refuses_where_there_is_nothing(tmp_path: Path) -> None:
    options = MeshingOptions(size=0.006, plug=True)
    with pytest.raises(MeshError, match="points to fill"):
        mesh_part(write(tmp_path, PARTS["box"]), options, fill=stand_in)
    solid = write(tmp_path, joined(moved(box(12, 8, 60), 1.0)), "solid.stl")
    with pytest.raises(MeshError, match="no hollow with a narrow opening was found that a plug could close"):
        mesh_part(solid, options, fill=lambda *given: box_mesh((0.1, 0.1, 0.1), (1, 1, 1)))


@pytest.mark.slow
@pytest.mark.skipif(not have_mesher(), reason="needs pytetwild (pip install 'softsim[mesh]')")
def test_a_plugged_part_is_driven_by_air(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("rclpy")
    from softsim_core.scene import load_scene
    from softsim_ros.cli import main

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    part = write(tmp_path, PARTS["box"])
    assert main(["new", "pump", "--from", str(part), "--size", "6", "--plug"]) == 0
    shown = capsys.readouterr().out
    assert "plugged the opening of 5" in shown
    assert "the pressure of its hollow" in shown
    assert load_scene(tmp_path / "pump" / "pump.yaml").scene.joint_names == ("air",)
