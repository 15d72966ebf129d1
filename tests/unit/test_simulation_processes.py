"""Across processes: the same bytes from the same commands, and a life without Numba."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]

RUN = """
import hashlib, sys
import numpy as np
from softsim_core import Simulation, load_scene
sim = Simulation(load_scene("tripod"), backend=sys.argv[1])
sim.start_animation()
rng = np.random.default_rng(0)
for step in range(60):
    if step > 25 and step % 5 == 0:
        sim.command(rng.uniform(-1.5, -0.5, 3))
        sim.forces[:] = rng.normal(scale=1e-3, size=sim.forces.shape)
    sim.step()
print(hashlib.sha256(sim.snapshot()).hexdigest())
"""

WITHOUT_NUMBA = """
import sys
sys.modules["numba"] = None  # importing it fails as if it were not installed
from softsim_core import Simulation, load_scene
first = Simulation(load_scene("tripod"))
second = Simulation(load_scene("tripod"), backend="auto")
for sim in (first, second):
    for _ in range(3):
        sim.step()
    print(sim.backend)
try:
    Simulation(load_scene("tripod"), backend="numba")
except Exception as error:
    print(type(error).__name__, error)
"""


def python(code: str, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code, *arguments],
        cwd=REPOSITORY,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=300,
        check=True,
    )


@pytest.mark.slow
def test_two_processes_compute_the_same_bytes(backend: str) -> None:
    """Whatever the order of hashes, and wherever the arrays lie in memory."""
    digests = {
        python(RUN, backend, PYTHONHASHSEED=hash_seed, MALLOC_PERTURB_=perturb).stdout
        for hash_seed, perturb in (("1", "0"), ("2", "165"))
    }
    assert len(digests) == 1
    assert len(digests.pop().strip()) == 64


@pytest.mark.slow
def test_without_numba_the_readable_step_runs_and_says_so_once() -> None:
    result = python(WITHOUT_NUMBA)
    lines = result.stdout.splitlines()
    assert lines[:2] == ["scipy", "scipy"]
    assert lines[2] == "SceneError backend numba needs the package numba: pip install numba, or use scipy"
    assert result.stderr.count("numba is not installed") == 1, result.stderr
