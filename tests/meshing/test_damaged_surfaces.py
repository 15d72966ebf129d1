"""Surfaces that are damaged at random: a closed one with a volume comes out, or one sentence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from part_surfaces import Surface, ball, box, joined, moved, rod, tilted, torus, write

from softsim_core.base import MeshError
from softsim_core.lab.meshing import read_part, repair_part
from softsim_core.physics.mesh import is_closed

BASES = (ball(10.0, 1), box(20.0, 20.0, 20.0, 3), torus(15.0, 4.0, 16, 8), rod(5.0, 40.0, 8))
KINDS = ("missing", "turned", "twice", "stray", "shaken", "bent", "pinched", "crossed")


def damaged(surface: Surface, rng: np.random.Generator) -> Surface:
    points, faces = surface[0].copy(), surface[1].copy()
    for kind in rng.choice(KINDS, rng.integers(1, 4)):
        count = int(rng.integers(1, 1 + max(1, len(faces) // 10)))
        some = rng.choice(len(faces), count, replace=False)
        if kind == "missing":
            faces = np.delete(faces, some, axis=0)
        elif kind == "turned":
            faces[some] = faces[some][:, ::-1]
        elif kind == "twice":
            faces = np.concatenate([faces, faces[some]])
        elif kind == "stray":
            faces = np.concatenate([faces, rng.integers(0, len(points), (count, 3))])
        elif kind == "shaken":
            points = points + rng.normal(0.0, 10.0 ** rng.uniform(-7.0, 0.5), points.shape)
        elif kind == "bent":
            faces[some, rng.integers(0, 3)] = rng.integers(0, len(points), count)
        elif kind == "pinched":
            points[rng.integers(0, len(points), count)] = points[rng.integers(0, len(points))]
        else:
            other = moved(tilted(surface, *rng.uniform(-180.0, 180.0, 3)), *rng.uniform(-30.0, 30.0, 3))
            points, faces = joined((points, faces), other)
    return points, faces


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("base", range(len(BASES)))
def test_damage_is_mended_or_told(base: int, tmp_path: Path) -> None:
    mended, refusals = 0, []
    for seed in range(40):
        rng = np.random.default_rng([base, seed])
        file = write(tmp_path, damaged(BASES[base], rng))
        try:
            result = repair_part(read_part(file), 1e-2 if seed % 2 else None, largest=seed % 3 == 0)
        except MeshError as refusal:
            refusals.append(str(refusal))
            continue
        mended += 1
        assert result.volume > 0.0
        assert is_closed(result.surface.triangles) or any("touches itself" in told for told in result.remarks)
    assert 8 <= mended <= 36
    assert all("\n" not in refusal and len(refusal) < 500 for refusal in refusals)
