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

from softsim_core.base import SnapshotError, SoftSimError, write_file
from softsim_core.scene import RobotDescription
from softsim_core.scene.io import shorten
from softsim_node import GuardedNode
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

    Two robots of one kind in two namespaces thus do not share a file.

    Args:
        robot: The robot.
        namespace: Namespace of the node; in `/lab/left` the name is `lab.left.tripod`.
    """
    place = namespace.strip("/")
    if place in ("", robot.namespace.strip("/")):
        return robot.name
    return f"{place.replace('/', '.')}.{robot.name}"[-LONGEST_NAME:].lstrip("_.-")


class SnapshotFolder:
    """Snapshots by name in a folder; links are not followed, and only ordinary files are overwritten.

    Args:
        folder: Created with the first snapshot.
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


def attempt(action: Callable[[], str]) -> tuple[bool, str]:
    """Run an action; return its success and its message for the response of a service."""
    try:
        return True, action()
    except SoftSimError as error:
        return False, str(error)


def answering(
    action: Callable[[], str],
) -> Callable[[Trigger.Request, Trigger.Response], Trigger.Response]:
    """Return a service callback that runs `action` and responds with its message."""

    def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = attempt(action)
        return response

    return answer


class RunServices:
    """`~/reset`, `~/step`, `~/start`, `~/pause`.

    Args:
        node: The simulator's node.
        physics: Thread that the services act on.
        on_pause_change: Called once a pause has begun or ended, before the response is sent.
    """

    def __init__(
        self, node: GuardedNode, physics: PhysicsThread, on_pause_change: Callable[[], None]
    ) -> None:
        self._physics, self._on_pause_change = physics, on_pause_change
        for name, action in (("reset", self._reset), ("step", self._step), ("start", self._start)):
            node.create_service(Trigger, f"~/{name}", answering(action))
        node.create_service(SetBool, "~/pause", self._on_pause)

    def _reset(self) -> str:
        self._physics.reset()
        paused = self._physics.status.paused
        return "back at the start of the scene" + ("; still paused" if paused else "")

    def _step(self) -> str:
        self._physics.step_once()
        return f"step {self._physics.status.steps} done"

    def _start(self) -> str:
        self._physics.play_start()
        return "start animation begun"

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        def pause() -> str:
            self._physics.pause(request.data)
            return "paused" if request.data else "running"

        response.success, response.message = attempt(pause)
        self._on_pause_change()
        return response


class SnapshotServices:
    """`~/save`, `~/load`.

    Args:
        node: The simulator's node.
        physics: Thread that owns the state.
        snapshots: Folder of the snapshots.
        name: Returns the name of the snapshot to save or load.
        loaded: Called after a snapshot was loaded.
    """

    def __init__(
        self,
        node: GuardedNode,
        physics: PhysicsThread,
        snapshots: SnapshotFolder,
        name: Callable[[], str],
        loaded: Callable[[], None],
    ) -> None:
        self._physics, self._snapshots, self._name, self._loaded = physics, snapshots, name, loaded
        for service, action in (("save", self._save), ("load", self._load)):
            node.create_service(Trigger, f"~/{service}", answering(action))

    def _save(self) -> str:
        data = self._physics.call(lambda simulation: simulation.snapshot(), shows=False)
        return f"saved to {self._snapshots.write(self._name(), data)}"

    def _load(self) -> str:
        name = self._name()
        self._physics.restore(self._snapshots.read(name))
        self._loaded()
        return f"loaded from {self._snapshots.file(name)}"
