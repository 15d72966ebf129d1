"""Programs that step in NumPy keep freed memory: no page is asked for again and again."""

from __future__ import annotations

import subprocess
import sys

import pytest

FAULTS = """
import resource, sys, threading
import numpy as np
from softsim_node import reuse_freed_memory

if sys.argv[1] == "reused" and not reuse_freed_memory():
    sys.exit(7)


def arrays():
    for _ in range(20):
        held = [np.ones(80_000) for _ in range(6)]
        del held  # all at once: what is free at the top of the heap is given back, whatever lies between


def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    arrays()
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


def run():
    arrays()
    print(faults())


thread = threading.Thread(target=run)
thread.start()
thread.join()
"""


def faults(how: str) -> int | None:
    """Page faults of 120 arrays in a thread; None: this system's malloc has no such setting."""
    run = subprocess.run([sys.executable, "-c", FAULTS, how], capture_output=True, text=True)
    if run.returncode == 7:
        return None
    assert run.returncode == 0, run.stderr
    return int(run.stdout)


def test_arrays_of_a_thread_come_without_page_faults() -> None:
    kept = faults("reused")
    if kept is None:
        pytest.skip("no glibc")
    left = faults("left")
    assert left is not None
    assert kept < left / 20
