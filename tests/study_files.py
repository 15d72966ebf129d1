"""Studies as files for tests, and stores byte by byte."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

LOAD: dict[str, Any] = {
    "name": "load",
    "scene": "cable_finger",
    "variables": [{"name": "g", "unit": "m/s^2", "lower": 0.0, "upper": 9.81, "count": 5}],
    "overlay": {"gravity": [0.0, 0.0, "= -g"]},
    "measure": [{"name": "tip", "of": "effector.position"}],
    "duration": 0.05,
    "block": 2,
}
"""The cable finger under more and more of its own weight."""

FUNCTIONS = """
import os, signal, time
from pathlib import Path

def gated(simulation):
    gate = Path(__file__).with_name("gate")
    while gate.exists() and -simulation.scene.gravity[2] > float(gate.read_text()):
        time.sleep(0.02)
    return 1.0

def faulty(simulation):
    case = -simulation.scene.gravity[2]
    if case == 1.0:
        raise ValueError("one is refused")
    if case == 2.0:
        while True:
            pass
    if case == 3.0:
        os.kill(os.getpid(), signal.SIGKILL)
    return case
"""


def written(folder: Path, **changes: Any) -> Path:
    """The study LOAD with some keys changed, as a file; those that are None are left out."""
    data = {key: value for key, value in {**LOAD, **changes}.items() if value is not None}
    file = folder / f"{data['name']}.yaml"
    file.write_text(yaml.safe_dump(data), encoding="utf-8")
    (folder / "functions.py").write_text(FUNCTIONS, encoding="utf-8")
    return file


@contextmanager
def gate(folder: Path, gravity: float) -> Iterator[None]:
    """Runs of `gated` under more gravity than this, in [m/s^2], wait until the block ends."""
    file = folder / "gate"
    file.write_text(str(gravity))
    try:
        yield
    finally:
        file.unlink()


def fingerprint(folder: Path) -> dict[str, str]:
    """SHA-256 of every file below a folder by its path."""
    return {
        str(file.relative_to(folder)): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }
