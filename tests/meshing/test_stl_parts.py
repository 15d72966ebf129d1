"""The parts to try with: sound, as large as they are drawn, and on disk as their script makes them."""

from __future__ import annotations

import itertools
import math
import sys
from pathlib import Path

import numpy as np
import pytest

from softsim_core.lab.meshing import read_part, repair_part
from softsim_core.robots import stl_parts

PARTS = Path(__file__).resolve().parents[2] / "configs" / "parts"


def test_the_files_are_what_the_script_writes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["stl_parts", "--out", str(tmp_path)])
    assert stl_parts.main() == 0
    written = sorted(file.name for file in tmp_path.iterdir())
    assert written == sorted(file.name for file in PARTS.iterdir())
    for name in written:
        assert (tmp_path / name).read_bytes() == (PARTS / name).read_bytes()


@pytest.mark.parametrize("name", ["fin_ray_finger", "bellows", "lattice_gripper"])
def test_a_part_is_sound_and_stands_on_the_ground(name: str) -> None:
    part = repair_part(read_part(PARTS / f"{name}.stl"))
    assert part.remarks == (("1 hollow inside",) if name == "bellows" else ())
    assert not part.crosses
    assert part.surface.points[:, 2].min() == 0.0


def test_the_fin_ray_finger_has_the_volume_of_its_profile() -> None:
    """A trapezium of 30 and 8 mm by 100 mm, less five windows, 20 mm wide."""
    gap = (100.0 - 15.0 - 6 * 2.5) / 5
    depth = [30.0 - 22.0 * z / 100.0 - 6.0 for k in range(5) for z in (2.5 + k * (gap + 2.5) + gap / 2,)]
    area = 0.5 * (30.0 + 8.0) * 100.0 - gap * sum(depth)
    part = repair_part(read_part(PARTS / "fin_ray_finger.stl"))
    assert 1e9 * part.volume == pytest.approx(20.0 * area, rel=1e-6)


def test_the_bellows_have_the_volume_of_their_rings() -> None:
    """Prisms of 24 sides between the levels; each is a frustum."""
    share = 24 / 2 * math.sin(2 * math.pi / 24)
    levels = np.linspace(0.0, 48.0, 25)
    outer = 10.0 + 2.0 * (1.0 - np.cos(2 * np.pi * levels / 12.0))

    def frusta(radius: np.ndarray) -> float:
        a, b = radius[:-1], radius[1:]
        return share * float(((a * a + a * b + b * b) / 3.0 * 2.0).sum())

    ends = 2 * 4.0 * share * 10.0**2
    part = repair_part(read_part(PARTS / "bellows.stl"))
    assert 1e9 * part.volume == pytest.approx(frusta(outer) - frusta(outer - 2.0) + ends, rel=2e-3)


def test_the_lattice_has_the_volume_of_its_struts() -> None:
    """Struts shrink along x with the height; y and z stay."""
    z = np.concatenate([[0.0], np.cumsum([4.0, *[7.0, 3.0] * 5, 7.0, 4.0])])
    expected = 0.0
    for k, (low, high) in enumerate(itertools.pairwise(z)):
        if k in (0, 12):
            layer = 23.0 * 13.0  # a plate
        else:
            layer = 6 * 9.0 if k % 2 else 23.0 * 13.0 - 2 * 49.0  # posts, or a grid with two windows
        expected += layer * (high - low) * (1.0 - 0.35 * 0.5 * (low + high) / z[-1])
    part = repair_part(read_part(PARTS / "lattice_gripper.stl"))
    assert 1e9 * part.volume == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_blocks_of_a_ring_have_a_closed_surface_with_their_volume(seed: int) -> None:
    full = np.random.default_rng(seed).random((12, 3, 4)) < 0.5
    full[:, 1] = False  # blocks that meet in an edge only have none in common here
    full[:, :, 1::2] = False
    full[::3] = False

    def corner(around: np.ndarray, outward: np.ndarray, up: np.ndarray) -> np.ndarray:
        angle, radius = -2.0 * np.pi * around / 12.0, 5.0 + outward
        return np.stack([radius * np.cos(angle), radius * np.sin(angle), up], axis=-1)

    surface = stl_parts.blocks(full, corner, "ring", around=True)
    edges = np.sort(surface.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()
    inner, outer = 5.0 + np.arange(3), 6.0 + np.arange(3)
    prism = 0.5 * math.sin(2.0 * math.pi / 12.0) * (outer**2 - inner**2)
    corners = surface.points[surface.triangles]
    volume = np.linalg.det(corners).sum() / 6.0
    assert volume == pytest.approx((full * prism[:, None]).sum(), rel=1e-6)
