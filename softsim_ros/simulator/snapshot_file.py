"""Where snapshots of a robot are kept, and how one is written so that no half file is ever seen."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from softsim_core.errors import SnapshotError


def default_snapshot_file(robot: str, environment: Mapping[str, str] = os.environ) -> Path:
    """`softsim/ROBOT.snapshot` under XDG_STATE_HOME, or under ~/.local/state where that is not set."""
    state_home = environment.get("XDG_STATE_HOME") or str(
        Path(environment.get("HOME", tempfile.gettempdir()), ".local", "state")
    )
    return Path(state_home) / "softsim" / f"{robot}.snapshot"


def write_snapshot(file: Path, data: bytes) -> None:
    """Write a snapshot whole or not at all; folders are made as needed.

    Raises:
        SnapshotError: the file cannot be written; an older one is kept.
    """
    temporary = ""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        descriptor, temporary = tempfile.mkstemp(prefix=f".{file.name}.", dir=file.parent)
        with os.fdopen(descriptor, "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        Path(temporary).replace(file)
    except OSError as error:
        with suppress(OSError):
            if temporary:
                Path(temporary).unlink()
        raise SnapshotError(f"snapshot {file} not written: {error.strerror}; set snapshot_file") from error


def read_snapshot(file: Path) -> bytes:
    """The bytes of a snapshot file.

    Raises:
        SnapshotError: the file cannot be read.
    """
    try:
        return file.read_bytes()
    except FileNotFoundError as error:
        raise SnapshotError(f"snapshot {file} does not exist; save one first") from error
    except OSError as error:
        raise SnapshotError(f"snapshot {file} not read: {error.strerror}; set snapshot_file") from error
