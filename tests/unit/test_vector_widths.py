"""The vector code serves processors without AVX-512 too: narrower vectors give the same motion."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.exhaustive, pytest.mark.numba]  # compiles everything anew

SCRIPT = """
import numpy as np
from softsim_core import Simulation, load_scene
from softsim_core.physics.linalg import LANES

runs = [Simulation(load_scene("tripod"), backend) for backend in ("numba", "scipy")]
for simulation in runs:
    simulation.command([-1.0, -0.4, -0.7])
    for _ in range(30):
        simulation.step()
fast, plain = runs
print(LANES, np.abs(fast.positions - plain.positions).max())
print(np.abs(fast.von_mises() - plain.von_mises()).max())
"""


@pytest.mark.skipif(platform.machine() != "x86_64", reason="names x86-64 processors")
def test_narrow_vectors_give_the_same_motion(tmp_path: Path) -> None:
    pytest.importorskip("numba")
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        env={
            **os.environ,
            "NUMBA_CPU_NAME": "haswell",
            "NUMBA_CPU_FEATURES": "+avx,+avx2,+fma",
            "NUMBA_CACHE_DIR": str(tmp_path),
            "PYTHONPATH": str(Path(__file__).resolve().parents[2]),
        },
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    lanes, position_error, stress_error = (float(word) for word in done.stdout.split())
    assert lanes == 4
    assert position_error < 1e-11
    assert stress_error < 1e-3
