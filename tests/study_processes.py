"""Studies in processes of their own for tests: started, waited for, killed."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from waiting import spin_until

PATIENCE_S = 400.0


def command(verb: str, study: Path, store: Path, *more: str) -> list[str]:
    words = [verb, str(study), "--out", str(store), "--allow-code", str(study.parent), *more]
    return [sys.executable, "-m", "softsim_ros.cli", *words]


def swept(study: Path, store: Path, *more: str, verb: str = "sweep") -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command(verb, study, store, *more), capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )


def started(study: Path, store: Path, *more: str, verb: str = "sweep") -> subprocess.Popen[str]:
    return subprocess.Popen(
        command(verb, study, store, *more),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def until(true: Callable[[], bool]) -> None:
    assert spin_until(true, PATIENCE_S)


def kept(store: Path) -> int:
    """Runs that lie in a store, in its journals too."""
    lines = 0
    chunks = store.glob("status/c/*")
    written = {int(each.name) for each in chunks if each.suffix != ".partial"}  # being written by Zarr
    for file in store.glob("journal/*"):
        if int(file.stem) in written:  # its journal is about to go
            continue
        with contextlib.suppress(FileNotFoundError):  # its block is complete since, and counted below
            lines += file.read_bytes().count(b"\n")
    grid = json.loads((store / "status" / "zarr.json").read_text())["chunk_grid"]
    return lines + len(written) * int(grid["configuration"]["chunk_shape"][0])


def children(pid: int) -> list[int]:
    """Processes below one, whole tree."""
    below: list[int] = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
        except (OSError, ValueError):
            continue
        if parent == pid:
            below += [int(entry.name), *children(int(entry.name))]
    return below


def workers(pid: int) -> list[int]:
    """Worker processes of a client."""
    found = []
    for each in children(pid):
        try:
            if b"spawn_main" in Path(f"/proc/{each}/cmdline").read_bytes():
                found.append(each)
        except OSError:
            continue
    return found
