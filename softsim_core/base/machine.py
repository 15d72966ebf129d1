"""The machine of a measurement, and the environment that limits numeric libraries to one thread."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import sys
from collections.abc import MutableMapping
from pathlib import Path

THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "NUMBA_NUM_THREADS",
)
"""Environment variables that numeric libraries read when they are loaded."""


def limit_threads(environment: MutableMapping[str, str]) -> bool:
    """Limit every numeric library to one thread.

    Args:
        environment: Changed in place, usually os.environ.

    Returns:
        Whether that is in time: False if NumPy was already loaded with another setting.
    """
    limited = all(environment.get(name) == "1" for name in THREAD_VARIABLES)
    environment.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    return limited or "numpy" not in sys.modules


def cpu_name() -> str:
    """Return the processor's name as the kernel reports it."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith(("model name", "Model")):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def version_of(distribution: str) -> str | None:
    """Return the version of an installed package; None if it is not installed."""
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None


def describe_machine() -> list[str]:
    """Return lines for the head of a report: processor, load, versions."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    load = f", load {os.getloadavg()[0]:.2f}" if hasattr(os, "getloadavg") else ""
    versions = {name: version_of(name) for name in ("numpy", "scipy", "numba")}
    packages = [f"{name} {version}" for name, version in versions.items() if version is not None]
    return [
        f"{cpu_name()}, {usable} cores usable, {platform.system()} {platform.machine()}{load}",
        f"Python {platform.python_version()}, {', '.join(packages)}",
    ]
