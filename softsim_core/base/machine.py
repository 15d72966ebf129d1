"""The machine of a measurement, its environment, and the command that installs optional packages on it."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import shlex
import sys
from collections.abc import MutableMapping
from pathlib import Path

THREAD_VARIABLES = tuple(f"{library}_NUM_THREADS" for library in ("OMP", "OPENBLAS", "MKL", "BLIS", "NUMBA"))
"""Environment variables that numeric libraries read when they are loaded."""


def limit_threads(environment: MutableMapping[str, str]) -> bool:
    """Limit every numeric library to one thread by an environment, usually os.environ, in place.

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


def usable_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def describe_machine() -> list[str]:
    """Return lines for the head of a report: processor, load, versions."""
    usable = usable_cores()
    load = f", load {os.getloadavg()[0]:.2f}" if hasattr(os, "getloadavg") else ""
    versions = {name: version_of(name) for name in ("numpy", "scipy", "numba")}
    packages = [f"{name} {version}" for name, version in versions.items() if version is not None]
    return [
        f"{cpu_name()}, {usable} cores usable, {platform.system()} {platform.machine()}{load}",
        f"Python {platform.python_version()}, {', '.join(packages)}",
    ]


def install_command(extra: str) -> str:
    """Return the command that installs an extra of pyproject.toml, such as "study", where it is missing.

    In the environment of a checkout, such as that of `./softsim`, plain pip would install into another
    Python.
    """
    root = Path(__file__).resolve().parents[2]
    constraints = root / "constraints.txt"
    if sys.prefix == sys.base_prefix or not constraints.is_file():
        return f"pip install 'softsim[{extra}]'"
    pip = str(Path(sys.executable).with_name("pip"))
    words = [pip, "install", "-c", str(constraints), "-e", f"{root}[{extra}]"]
    return shlex.join(words)
