"""Episodes whose scene is drawn anew leave no memory behind."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("gymnasium")
pytest.importorskip("numba")

REPOSITORY = Path(__file__).resolve().parents[2]
SCRIPT = Path(__file__).with_name("randomised_episodes.py")
GROWTH_MB = 5.0
DRAWN = """
name: soft_and_slow
parameters:
  modulus: {uniform: [180.0e+3, 320.0e+3]}
  mass: {normal: [0.032, 0.004], bounds: [0.025, 0.040]}
scene:
  bodies: [{name: silicone, material: {young_modulus: = modulus}, total_mass: = mass}]
"""


@pytest.mark.slow
@pytest.mark.parametrize("episodes", [80, pytest.param(100_000, marks=pytest.mark.exhaustive)])
def test_randomised_episodes_leave_no_memory_behind(tmp_path: Path, episodes: int) -> None:
    file = tmp_path / "drawn.yaml"
    file.write_text(DRAWN)
    paths = os.pathsep.join([str(REPOSITORY), *filter(None, sys.path)])
    words = [sys.executable, str(SCRIPT), str(file), str(episodes)]
    done = subprocess.run(
        words, env={**os.environ, "PYTHONPATH": paths}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    print(done.stdout)
    seen = [json.loads(line)[1] for line in done.stdout.splitlines()]
    assert len(seen) == 11
    assert seen[-1] - seen[1] < GROWTH_MB, seen  # a tenth of the episodes may fill caches
