"""Services that run, pause, step and reset a simulation, and save and restore its state."""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final

from std_srvs.srv import SetBool, Trigger

from softsim_core.base import SnapshotError, shorten, write_file
from softsim_core.scene import RobotDescription
from softsim_node import GuardedNode, answering
from softsim_ros.nodes.simulator.physics_thread import PhysicsThread

MOST_BYTES: Final = 2**30
"""Largest size of a snapshot file in bytes."""

SUFFIX: Final = ".snapshot"
LONGEST_NAME: Final = 64
"""Largest number of characters in a snapshot's name."""

_NAME: Final = re.compile(rf"[A-Za-z0-9][A-Za-z0-9_.-]{{0,{LONGEST_NAME - 1}}}")


def default_folder(environment: Mapping[str, str] = os.environ) -> Path:
    """Return `softsim` under XDG_STATE_HOME, or under ~/.local/state where that is not set."""
    home = environment.get("HOME") or os.path.expanduser("~")  # noqa: PTH111 (which may find none)
    return Path(environment.get("XDG_STATE_HOME") or Path(home, ".local", "state")) / "softsim"


def default_name(robot: RobotDescription, namespace: str) -> str:
    """Return the default snapshot name of a robot: its name, prefixed by a namespace that is not its own.

    Two robots of one kind in two namespaces thus do not share a file; in `/lab/left` the name is
    `lab.left.tripod`.
    """
    place = namespace.strip("/")
    if place in ("", robot.namespace.strip("/")):
        return robot.name
    return f"{place.replace('/', '.')}.{robot.name}"[-LONGEST_NAME:].lstrip("_.-")


class SnapshotFolder:
    """Snapshots by name in a folder, which is created with the first one.

    Links are not followed, and only ordinary files are overwritten.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def file(self, name: str) -> Path:
        """Return the path of a snapshot.

        Raises:
            SnapshotError: the name is not allowed.
        """
        if not _NAME.fullmatch(name):
            raise SnapshotError(
                f"snapshot name {shorten(name)!r} is refused; allowed are at most {LONGEST_NAME} letters, "
                "digits, '_', '-' and '.', beginning with a letter or digit"
            )
        return self._folder / f"{name}{SUFFIX}"

    def write(self, name: str, data: bytes) -> Path:
        """Write a snapshot completely or not at all; return its path.

        Raises:
            SnapshotError: the name is not allowed, a link or a device is in its place, or the file cannot be
                written; an older snapshot is preserved.
        """
        file = self.file(name)
        try:
            self._folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            with suppress(FileNotFoundError):
                _need_ordinary(file, file.lstat())
            write_file(file, data, mode=0o600)
        except OSError as error:
            raise SnapshotError(
                f"snapshot {file} not written: {error.strerror}; start with another snapshot_folder"
            ) from error
        return file

    def read(self, name: str) -> bytes:
        """Return the bytes of a snapshot.

        Raises:
            SnapshotError: the name is not allowed, there is none, it is no ordinary file, or it cannot be
                read.
        """
        file = self.file(name)
        try:
            _need_ordinary(file, file.lstat())
            flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK  # a pipe put there since cannot block
            with os.fdopen(os.open(file, flags), "rb") as stream:
                _need_ordinary(file, os.fstat(stream.fileno()))
                return stream.read(MOST_BYTES)
        except FileNotFoundError as error:
            raise SnapshotError(f"snapshot {file} does not exist; save one first") from error
        except OSError as error:
            raise SnapshotError(f"snapshot {file} not read: {error.strerror}") from error


def _need_ordinary(file: Path, status: os.stat_result) -> None:
    """Raise if the file is a link, a device or a folder, or if it is too large."""
    if not stat.S_ISREG(status.st_mode):
        raise SnapshotError(
            f"snapshot {file} is a link, a device or a folder, not an ordinary file; remove it"
        )
    if status.st_size > MOST_BYTES:
        raise SnapshotError(f"snapshot {file} is larger than {MOST_BYTES >> 20} MiB; remove it")


def create_run_services(
    node: GuardedNode, physics: PhysicsThread, on_pause_change: Callable[[], None]
) -> None:
    """Create `~/reset`, `~/step`, `~/start` and `~/pause`.

    `on_pause_change` is called once a pause has begun or ended, before the response is sent.
    """

    def reset() -> str:
        physics.reset()
        return "back at the start of the scene" + ("; still paused" if physics.status.paused else "")

    def step() -> str:
        physics.step_once()
        return f"step {physics.status.steps} done"

    def start() -> str:
        physics.play_start()
        return "start animation begun"

    def pause(paused: bool) -> str:
        try:
            physics.pause(paused)
        finally:
            on_pause_change()
        return "paused" if paused else "running"

    for action in (reset, step, start):
        node.create_service(Trigger, f"~/{action.__name__}", answering(action))
    node.create_service(SetBool, "~/pause", answering(pause))


def create_snapshot_services(
    node: GuardedNode,
    physics: PhysicsThread,
    snapshots: SnapshotFolder,
    name: Callable[[], str],
    loaded: Callable[[], None],
) -> None:
    """Create `~/save` and `~/load` of the snapshot that `name` returns; `loaded` is called after a load."""

    def save() -> str:
        data = physics.call(lambda simulation: simulation.snapshot(), shows=False)
        return f"saved to {snapshots.write(name(), data)}"

    def load() -> str:
        chosen = name()
        physics.restore(snapshots.read(chosen))
        loaded()
        return f"loaded from {snapshots.file(chosen)}"

    for action in (save, load):
        node.create_service(Trigger, f"~/{action.__name__}", answering(action))
