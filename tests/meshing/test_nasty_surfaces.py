"""Broken and unusual surfaces: each is repaired with a word or refused in one sentence that says where.

Lengths are those of the file, mm. A repaired one has its volume in closed form, and is closed by an
independent reader's account (trimesh).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from part_surfaces import (
    Surface,
    ball,
    box,
    inside_out,
    joined,
    moebius,
    moved,
    pinched_ring,
    rod,
    sheet,
    stl,
    text_stl,
    tilted,
    torus,
    volume,
    without,
    write,
)

from softsim_core.base import MeshError
from softsim_core.lab.meshing import RepairedSurface, read_part, repair_part, simplify_surface
from softsim_core.physics.mesh import is_closed

CUBE = 8000.0


@dataclass(frozen=True)
class Mended:
    """Volume in mm^3 and what is told; `word` "" where nothing is."""

    surface: Surface | bytes
    volume: float
    word: str = ""
    hole: float | None = None
    largest: bool = False
    unit: str = "mm"
    name: str = "part.stl"


@dataclass(frozen=True)
class Refused:
    """What the one sentence says."""

    surface: Surface | bytes
    word: str
    unit: str = "mm"
    name: str = "part.stl"


def rng(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


def some_turned(surface: Surface, seed: int, share: float) -> Surface:
    faces = surface[1].copy()
    turn = rng(seed).random(len(faces)) < share
    faces[turn] = faces[turn][:, ::-1]
    return surface[0], faces


def shuffled(surface: Surface, seed: int) -> Surface:
    return surface[0], rng(seed).permutation(surface[1])


def also(surface: Surface, *triangles: list[int]) -> Surface:
    return surface[0], np.concatenate([surface[1], np.array(triangles)])


def split_edge(surface: Surface) -> Surface:
    """The first triangle is cut at the middle of an edge, its neighbour is not: a gap without width."""
    points, faces = surface
    a, b, c = faces[0]
    middle = len(points)
    points = np.concatenate([points, 0.5 * (points[a] + points[b])[None]])
    return points, np.concatenate([faces[1:], [[a, middle, c], [middle, b, c]]])


def needles(surface: Surface) -> Surface:
    """The same, and the gap is closed by a triangle without area."""
    points, faces = split_edge(surface)
    a, b = surface[1][0, :2]
    return points, np.concatenate([faces, [[a, b, len(points) - 1]]])


def cracked(surface: Surface, seed: int, width: float) -> Surface:
    """Each triangle has corners of its own, up to `width` beside where they were."""
    corners = surface[0][surface[1]]
    corners = corners + rng(seed).uniform(-width, width, corners.shape)
    return corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)


def ring_around(surface: Surface, vertex: int) -> list[int]:
    return np.flatnonzero((surface[1] == vertex).any(axis=1)).tolist()


def face_of(surface: Surface, axis: int, value: float) -> list[int]:
    return np.flatnonzero((np.abs(surface[0][surface[1]][:, :, axis] - value) < 1e-9).all(axis=1)).tolist()


def shared_edge() -> Surface:
    return joined(box(), moved(box(), 20.0, 20.0, 0.0))


def shared_corner() -> Surface:
    return joined(box(), moved(box(), 20.0, 20.0, 20.0))


def inner_wall() -> Surface:
    """A box with a wall across its middle that ends at the box's own edges."""
    points, faces = box(40.0, 20.0, 20.0, 2)
    middle = np.flatnonzero(np.abs(points[:, 0]) < 1e-9)
    centre = len(points)
    order = np.argsort(np.arctan2(points[middle, 2], points[middle, 1]))
    ring = middle[order]
    wall = np.column_stack([ring, np.roll(ring, -1), np.full(len(ring), centre)])
    return np.concatenate([points, np.zeros((1, 3))]), np.concatenate([faces, wall])


def soup(seed: int) -> Surface:
    return rng(seed).uniform(-10.0, 10.0, (90, 3)), np.arange(90).reshape(-1, 3)


def klein(around: int = 40, across: int = 20) -> Surface:
    """Closed, one side only; it passes through itself."""
    u, v = np.meshgrid(
        2 * np.pi * np.arange(around) / around, 2 * np.pi * (np.arange(across) + 0.5) / across, indexing="ij"
    )
    r = 20.0 + 5.0 * (np.cos(u / 2) * np.sin(v) - np.sin(u / 2) * np.sin(2 * v))
    points = np.stack(
        [r * np.cos(u), r * np.sin(u), 5.0 * (np.sin(u / 2) * np.sin(v) + np.cos(u / 2) * np.sin(2 * v))], -1
    ).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")

    def at(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        over = a == around  # a half turn: v goes to -v
        return np.where(over, (-b - 1) % across, (a % around) * across + b % across)

    a, b, c, d = at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)
    return points, np.concatenate(
        [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
    )


def with_number(value: float) -> bytes:
    points, faces = box()
    points = points.copy()
    points[3, 1] = value
    return stl((points, faces))


BALL = volume(ball())
FINE = box(20, 20, 20, 4)
ENDS = (*face_of(rod(), 2, 20.0), *face_of(rod(), 2, -20.0))
SHELL = joined(ball(10.0, 3), inside_out(ball(9.95, 3)))
CASES: dict[str, Callable[[], Mended | Refused]] = {
    # sound ones, however they lie
    "a cube": lambda: Mended(box(), CUBE),
    "tilted by odd angles": lambda: Mended(tilted(box(), 13.0, 37.0, 71.0), CUBE),
    "tilted torus": lambda: Mended(tilted(torus(), 5.0, -50.0, 11.0), volume(torus())),
    "far from the origin": lambda: Mended(moved(box(), 500.0, -300.0, 100.0), CUBE),
    "triangles in any order": lambda: Mended(shuffled(ball(), 3), BALL),
    "binary that begins with solid": lambda: Mended(b"solid part".ljust(80) + stl(box())[80:], CUBE),
    "text": lambda: Mended(text_stl(box()), CUBE),
    "text in capitals and CRLF": lambda: Mended(text_stl(box()).upper().replace(b"\n", b"\r\n"), CUBE),
    # holes
    "one triangle missing": lambda: Mended(without(ball(), 17), BALL, "closed a hole", 6.0),
    "a ring of triangles missing": lambda: Mended(
        without(ball(10.0, 3), *ring_around(ball(10.0, 3), 0)), volume(ball(10.0, 3)), "closed a hole", 6.0
    ),
    "three triangles missing": lambda: Mended(
        without(ball(10.0, 4), 5, 900, 2000), volume(ball(10.0, 4)), "closed 3 holes", 2.0
    ),
    "small hole by itself": lambda: Mended(
        without(ball(10.0, 4), 40), volume(ball(10.0, 4)), "closed a hole"
    ),
    "face missing": lambda: Refused(
        without(box(), *face_of(box(), 2, 10.0)), r"open: a hole of 28\.28 mm across around \(0, 0, 10\) mm"
    ),
    "face missing, allowed": lambda: Mended(
        without(box(20, 20, 20, 4), *face_of(box(20, 20, 20, 4), 2, 10.0)),
        CUBE,
        "closed a hole of 28.28 mm",
        30,
    ),
    "both ends of a rod missing": lambda: Refused(
        without(rod(), *face_of(rod(), 2, 20.0), *face_of(rod(), 2, -20.0)),
        "2 holes, the largest of 14.14 mm",
    ),
    "both ends of a rod missing, allowed": lambda: Mended(
        without(rod(), *face_of(rod(), 2, 20.0), *face_of(rod(), 2, -20.0)),
        volume(rod()),
        "closed 2 holes",
        15,
    ),
    "bent hole, not convex": lambda: Mended(
        without(FINE, *(n for n in face_of(FINE, 0, 10.0) if n % 7)),
        CUBE,
        "closed",
        40.0,
    ),
    "gap without width": lambda: Mended(split_edge(box()), CUBE, "closed a hole", 30.0),
    # turned triangles
    **{
        f"a third turned, seed {seed}": lambda seed=seed: Mended(
            some_turned(ball(), seed, 0.33), BALL, "looked the other way"
        )
        for seed in range(3)
    },
    "one turned": lambda: Mended(some_turned(box(), 4, 0.1), CUBE, "looked the other way"),
    "all turned": lambda: Mended(inside_out(torus()), volume(torus()), "inside out"),
    "half turned": lambda: Mended(some_turned(torus(), 5, 0.5), volume(torus()), "looked the other way"),
    # triangles that are nothing, or twice
    "corners repeated": lambda: Mended(also(box(), [0, 0, 1], [2, 2, 2]), CUBE, "two equal corners"),
    "without area, needed": lambda: Mended(needles(box()), CUBE, "kept 1 triangle without area, which close"),
    "without area, not needed": lambda: Mended(
        (
            np.concatenate([box()[0], 0.5 * (box()[0][0] + box()[0][1])[None]]),
            np.concatenate([box()[1], [[0, 1, 8]]]),
        ),
        CUBE,
        "without area",
    ),
    "triangle twice": lambda: Mended(also(ball(), ball()[1][7].tolist()), BALL, "for repeating others"),
    "triangle twice, turned": lambda: Mended(
        also(ball(), ball()[1][7, ::-1].tolist()), BALL, "for repeating others"
    ),
    "all twice": lambda: Mended(joined(ball(), ball()), BALL, "for repeating others"),
    "all twice, turned": lambda: Mended(joined(ball(), inside_out(ball())), BALL, "for repeating others"),
    "corners beside each other": lambda: Mended(cracked(ball(), 6, 1e-6), BALL, "welded"),
    "corners far beside each other": lambda: Refused(cracked(ball(), 6, 0.5), "open|do not fit together"),
    # several shells
    "two bodies": lambda: Refused(joined(box(), moved(ball(), 50.0)), r"holds 2 bodies .* 20 x 20 x 20 mm"),
    "two bodies, the larger": lambda: Mended(
        joined(box(), moved(ball(), 50.0)), CUBE, "largest of 2 bodies", largest=True
    ),
    "a speck": lambda: Mended(joined(box(), moved(ball(0.03, 1), 15.0)), CUBE, "left out 1 shell with"),
    "two cubes with one face": lambda: Mended(
        joined(box(), moved(box(), 20.0)), 2 * CUBE, "for repeating others"
    ),
    "hollow": lambda: Mended(joined(box(), inside_out(ball(5.0))), CUBE - BALL / 8, "1 hollow inside"),
    "hollow that looks outward": lambda: Mended(joined(box(), ball(5.0)), CUBE - BALL / 8, "1 hollow inside"),
    "two hollows": lambda: Mended(
        joined(box(40, 20, 20), moved(ball(5.0), -10.0), moved(ball(5.0), 10.0)),
        2 * CUBE - BALL / 4,
        "2 hollows inside",
    ),
    "body in a hollow": lambda: Refused(joined(ball(20.0), ball(15.0), ball(5.0)), "holds 2 bodies"),
    "thin shell": lambda: Mended(SHELL, volume(SHELL), "1 hollow inside"),
    "thin plate": lambda: Mended(box(100.0, 100.0, 0.1), 1000.0),
    # passing through itself, touching itself
    "two boxes cross": lambda: Mended(
        joined(box(), moved(tilted(box(), 10, 20, 30), 9, 8, 7)), math.nan, "itself"
    ),
    "ball through a plate": lambda: Mended(
        joined(box(40, 40, 4), moved(tilted(ball(), 3, 4, 5), 1, 2, 0)), math.nan, "passes through itself"
    ),
    "three rods cross": lambda: Mended(
        joined(rod(), tilted(rod(4.9), 90, 1, 2), tilted(rod(4.8), 1, 90, 3)),
        math.nan,
        "passes through itself",
    ),
    "an edge in common": lambda: Refused(shared_edge(), "2 bodies that no face joins"),
    "a corner in common": lambda: Refused(shared_corner(), "2 bodies that no face joins"),
    "a ring that touches itself": lambda: Mended(pinched_ring(), 7 * 125.0, "touches itself in 2 points"),
    "a wall inside": lambda: Refused(inner_wall(), r"three triangles.* \(0, .* a wall ends there"),
    "a flap": lambda: Mended(
        also((np.concatenate([box()[0], [[0, 0, 40.0]]]), box()[1]), [*box()[1][0, :2].tolist(), 8]),
        CUBE,
        "hanging loose",
    ),
    # no body at all
    "sheet": lambda: Refused(sheet(), r"is open: a hole of 28\.\d+ mm across"),
    "sheet from both sides": lambda: Refused(joined(sheet(), inside_out(sheet())), "bounds a volume|open"),
    "folded flat": lambda: Refused((box()[0] * (1, 1, 0), box()[1]), "volume|thickness|area"),
    "Moebius strip": lambda: Refused(moebius(), "one side only"),
    "Klein bottle": lambda: Refused(klein(), "one side only"),
    "soup": lambda: Refused(soup(7), "open|do not fit"),
    "one triangle": lambda: Refused((box()[0], box()[1][:1]), "open"),
    "one point": lambda: Refused((np.zeros((3, 3)), np.array([[0, 1, 2]])), "one point|0 m long"),
    # files
    "no bytes": lambda: Refused(b"", "is empty"),
    "no triangles": lambda: Refused(stl((np.zeros((0, 3)), np.zeros((0, 3), int))), "holds no"),
    "text without triangles": lambda: Refused(b"solid nothing\nendsolid nothing\n", "holds no"),
    "points alone": lambda: Refused(b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "holds no triangles", name="part.obj"),
    "NaN": lambda: Refused(with_number(math.nan), "not finite"),
    "infinite": lambda: Refused(with_number(math.inf), "not finite"),
    "decimal commas": lambda: Refused(
        text_stl(box()).replace(b".", b","), "line 4: a vertex needs three numbers.* 'vertex"
    ),
    "text cut off": lambda: Refused(text_stl(box())[:-80], "cut off|three|exactly 3"),
    "binary cut off": lambda: Refused(stl(box())[:-7], "cut off"),
    "no known format": lambda: Refused(b"\x89PNG", "no known format", name="part.png"),
    # units
    "huge": lambda: Refused(box(1e9, 1e9, 1e9), "say the unit", "m"),
    "tiny": lambda: Refused(box(1e-6, 1e-6, 1e-6), "say the unit", "um"),
    "metres taken for mm": lambda: Mended(box(0.02, 0.02, 0.02), 8e-6, "is that so"),
    "inches": lambda: Mended(box(1.0, 1.0, 1.0), 1.0, unit="in"),
}


def mended(case: Mended, folder: Path) -> RepairedSurface:
    part = read_part(write(folder, case.surface, case.name), case.unit)
    hole = None if case.hole is None else case.hole * part.unit.metres
    return repair_part(part, hole, case.largest, simplify_surface)


def test_there_are_sixty() -> None:
    assert len(CASES) >= 60


@pytest.mark.parametrize("name", CASES)
def test_a_surface_is_repaired_with_a_word_or_refused_in_a_sentence(name: str, tmp_path: Path) -> None:
    case = CASES[name]()
    if isinstance(case, Refused):
        with pytest.raises(MeshError, match=case.word) as refusal:
            repair_part(
                read_part(write(tmp_path, case.surface, case.name), case.unit), None, False, simplify_surface
            )
        text = str(refusal.value)
        assert "\n" not in text
        assert len(text) < 500
        return
    result = mended(case, tmp_path)
    told = "; ".join(result.remarks)
    assert re.search(case.word, told), told
    if not case.word:
        assert told == ""
    assert is_closed(result.surface.triangles) or "touches itself" in told
    if math.isnan(case.volume):
        assert result.crosses
        return
    assert not result.crosses
    metres = result.unit.metres
    assert result.volume / metres**3 == pytest.approx(case.volume, rel=2e-3)
    trimesh = pytest.importorskip("trimesh")
    known = trimesh.Trimesh(result.surface.points / metres, result.surface.triangles, process=False)
    assert known.volume == pytest.approx(case.volume, rel=2e-3)
    assert known.is_watertight or "touches itself" in told


@pytest.mark.parametrize("refinements", [6, pytest.param(8, marks=pytest.mark.exhaustive)])
@pytest.mark.slow
def test_very_fine_surfaces_become_coarser(refinements: int, tmp_path: Path) -> None:
    """81 920 triangles, and 1.3 million: a sphere whose volume and radius are kept within a thousandth."""
    pytest.importorskip("fast_simplification")
    fine = ball(10.0, refinements)
    result = mended(Mended(fine, 0.0), tmp_path)
    assert len(result.surface.triangles) <= 40_000
    assert f"triangles for its {len(fine[1])}" in "; ".join(result.remarks)
    assert 1e9 * result.volume == pytest.approx(4000.0 / 3.0 * math.pi, rel=1e-3)
    radii = 1e3 * np.linalg.norm(result.surface.points, axis=1)
    assert np.abs(radii - 10.0).max() < 0.01
    assert is_closed(result.surface.triangles)
