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

PLAIN = """
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


@pytest.mark.numba
@pytest.mark.exhaustive  # all kernels of the robot are compiled; tests of kernels hold what it stands on
def test_the_process_that_needs_the_kernels_first_computes_the_same_bytes(tmp_path: Path) -> None:
    digests = [python(RUN, "numba", NUMBA_CACHE_DIR=str(tmp_path)).stdout for _ in range(2)]
    assert digests[0] == digests[1]


def told(result: subprocess.CompletedProcess[str], why: str) -> None:
    """That PLAIN ran on the SciPy path, and why, once."""
    lines = result.stdout.splitlines()
    assert lines[:2] == ["scipy", "scipy"]
    assert lines[2] == f"SceneError backend numba needs compiled kernels, but {why}, or use scipy"
    assert result.stderr.count(f"the slower NumPy + SciPy step runs: {why}") == 1, result.stderr


@pytest.mark.slow
def test_without_numba_the_readable_step_runs_and_says_so_once() -> None:
    not_there = 'import sys; sys.modules["numba"] = None  # its import fails, as where it is not installed'
    told(python(not_there + PLAIN), "numba is not installed: pip install numba")


@pytest.mark.slow
def test_where_numba_may_not_compile_the_readable_step_runs() -> None:
    """With contacts, too, whose kernels are then plain Python."""
    touching = """
sim = Simulation(load_scene("tripod_ball"))
sim.step()
print(sim.backend)
"""
    result = python(PLAIN + touching, NUMBA_DISABLE_JIT="1")
    told(result, "NUMBA_DISABLE_JIT is set, as for a debugger: unset it")
    assert result.stdout.splitlines()[3] == "scipy"
