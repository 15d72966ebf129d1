"""`softsim bench --scaling` measures meshes in processes of their own and tells how a step grows."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks import (
    SIZES,
    Scale,
    mesh_of,
    scaling_table,
    write_json,
)

MEASURED = Scale("box", "1k", 1000, 4374, 0.1, 8.0, 6.0, 0, 2, 5.0, 1.6, 60.0, 200_000, 6e7, 150.0)


def test_the_table_tells_the_exponent_between_meshes_of_one_shape(tmp_path: Path) -> None:
    other = replace(MEASURED, shape="silicone")
    larger = replace(MEASURED, size="3k", nodes=4000, step_ms=64.0, splu_ms=None)
    head, first, second, third = scaling_table([MEASURED, larger, other])
    assert head.split()[-1] == "exponent"
    assert [line.split()[-1] for line in (first, second, third)] == ["-", "1.50", "-"]
    write_json([MEASURED, larger], tmp_path / "numbers.json")
    assert json.loads((tmp_path / "numbers.json").read_text())[1]["step_ms"] == 64.0


@pytest.mark.parametrize("shape", ["box", "silicone"])
def test_meshes_grow_with_their_names(shape: str) -> None:
    assert len(mesh_of(shape, "1k").points) in range(700, 1100)
    assert len(mesh_of(shape, "3k").points) in range(2500, 3500)
    assert SIZES[-1] == "50k"


@pytest.mark.slow
@pytest.mark.numba
def test_one_mesh_is_measured_in_its_own_process() -> None:
    pytest.importorskip("numba")
    from benchmarks import measure_scaling

    (scale,) = measure_scaling(["1k"], ["silicone"])
    assert scale.splu_ms is not None
    assert min(scale.solve_ms, scale.step_ms, scale.threads_ms, scale.speed_up, scale.splu_ms) > 0.0
    assert 50.0 < scale.peak_mb < 2000.0  # some 220, and 1050 where the kernels are compiled in that process
