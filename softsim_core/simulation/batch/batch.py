"""Copies of a scene that are stepped together, on one or several cores."""

from __future__ import annotations

import mmap
import os
import pickle
import socket
import subprocess
import sys
import weakref
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from softsim_core.base import (
    Array,
    Backend,
    BatchError,
    CommandError,
    IndexArray,
    SoftSimError,
    SolverDivergedError,
    float_array,
    python_command,
    start_process,
)
from softsim_core.scene import RobotDescription, SceneDescription, as_robot
from softsim_core.simulation import Simulation


class Share:
    """The copies of a robot that one process steps.

    Args:
        robot: The robot that each is a copy of.
        backend: See Simulation.
        leader: The first copy, if it is already built; the others share what it has planned.
    """

    def __init__(
        self, robot: RobotDescription, backend: Backend | None, leader: Simulation | None = None
    ) -> None:
        self._robot, self._backend = robot, backend
        self._leader = Simulation(robot, backend) if leader is None else leader
        self._copies: list[Simulation] = []
        self._states: list[Array] = []
        self._failed: set[int] = set()

    def fill(self, states: Array) -> None:
        """Make one copy for each row of `states` (k, s); the copy stores its state in that row."""
        for row in states:
            copy = Simulation(self._robot, self._backend, self._leader) if self._copies else self._leader
            copy.store_state_in(row)
            self._copies.append(copy)
            self._states.append(row)

    def command(self, chosen: Sequence[int], values: Array) -> list[Array]:
        """Set the joint targets of each chosen copy to its row of `values`, and return the accepted commands.

        Raises:
            CommandError: a row has the wrong length, is not finite, or is out of range in a scene that
                refuses.
        """
        return [self._copies[k].command(row) for k, row in zip(chosen, values, strict=True)]

    def step(self, chosen: Sequence[int], steps: int) -> dict[int, str]:
        """Advance each chosen copy by a number of steps, and return the reason for each copy that diverged.

        A diverged copy stays at its last good state and is skipped until it is reset.
        """
        failed = {}
        for k in chosen:
            if k in self._failed:
                continue
            step = self._copies[k].step
            try:
                for _ in range(steps):
                    step()
            except SolverDivergedError as error:
                failed[k] = str(error)
                self._failed.add(k)
        return failed

    def reset(self, chosen: Sequence[int]) -> None:
        """Return each chosen copy to the start of its scene and clear its failure."""
        for k in chosen:
            self._copies[k].reset()
        self._failed.difference_update(chosen)

    def restore(self, chosen: Sequence[int], snapshot: bytes) -> None:
        """Restore a snapshot in each chosen copy and clear its failure.

        Raises:
            SnapshotError: not a snapshot of this scene, of another version, or damaged.
        """
        for k in chosen:
            self._copies[k].restore(snapshot)
        self._failed.difference_update(chosen)

    def rebuild(self, k: int, robot: RobotDescription) -> None:
        """Rebuild a copy from a scene that differs only in numbers; the copy starts again.

        Raises:
            BatchError: the scene differs in more than numbers; the copy is not changed.
            SceneError, MeshError, MaterialError: the scene cannot be built.
        """
        copy = Simulation(robot, self._backend, self._leader)
        if copy.state_parts != self._leader.state_parts or copy.joint_names != self._leader.joint_names:
            raise BatchError(
                f"scene {robot.name} has other nodes, frames, joints or bodies than the batch's; "
                "change numbers only, or make a batch of its own"
            )
        copy.store_state_in(self._states[k])
        self._copies[k] = copy  # the copies continue to share the plan of the leader
        self._failed.discard(k)

    def call(self, k: int, name: str, arguments: Sequence[Any], named: Mapping[str, Any]) -> Any:
        """Call a method of a copy and return its result, or return one of its attributes."""
        found = getattr(self._copies[k], name)
        return found(*arguments, **named) if callable(found) else found


def failure(error: Exception) -> Exception:
    """Return an error that can be sent to another process; foreign errors become BatchError."""
    if isinstance(error, SoftSimError) and error.args and len(error.args) == 1:
        own = BatchError(str(error))
        own.__cause__ = None
        return own
    return BatchError(f"{type(error).__name__}: {error}")


Chosen = Sequence[int] | IndexArray | None
"""Numbers of copies; None: all of them."""


class Batch(AbstractContextManager["Batch"]):
    """Copies of a scene that share geometry, plans and workspace; each has its own state.

    Each copy produces the same bytes as a Simulation with the same commands, whatever the number of workers
    and copies. A step holds Python's global lock for one fifth to two thirds of its time (with contact), so
    several cores are used by processes, not by threads. The states lie in memory that all processes share.

    Args:
        scene: The scene that each is a copy of.
        copies: Number of copies, >= 1.
        workers: Number of cores; 1: all copies run in this process.
        backend: See Simulation.

    Attributes:
        states: State.buffer of each copy, read-only, shape (N, s); see `array`.
        failed: Reason of divergence by number of the copy. A diverged copy stands still until it is reset.

    Raises:
        BatchError: a wrong number, or a scene that cannot be sent to another process.
        SceneError, MeshError, MaterialError: the scene cannot be built.
    """

    def __init__(
        self,
        scene: SceneDescription | RobotDescription,
        copies: int,
        workers: int = 1,
        backend: Backend | None = None,
    ) -> None:
        if copies < 1 or workers < 1:
            raise BatchError(f"a batch of {copies} copies on {workers} workers: both must be at least 1")
        robot = as_robot(scene)
        if workers > 1:  # one core each
            solver = replace(robot.scene.solver, threads=1)
            robot = replace(robot, scene=replace(robot.scene, solver=solver))
        leader = Simulation(robot, backend)
        self._parts = leader.state_parts
        self._joints, self._dt = leader.joint_names, leader.dt
        size = max(part.stop for part, _ in self._parts.values())
        ends = np.linspace(0, copies, min(workers, copies) + 1).round().astype(int).tolist()
        self._first = np.array(ends[:-1])
        self.failed: dict[int, str] = {}
        self._remote: list[_Worker] = []
        if len(ends) == 2:
            self.states: Array = np.zeros((copies, size))
        else:
            memory = os.memfd_create("softsim-batch")
            try:
                os.ftruncate(memory, 8 * copies * size)
                shared = mmap.mmap(memory, 8 * copies * size)
                self.states = np.frombuffer(shared, dtype=float).reshape(copies, size)
                self._remote = [_Worker(memory) for _ in ends[2:]]
                self._closing = weakref.finalize(self, _close, self._remote)
                for worker, first, end in zip(self._remote, ends[1:-1], ends[2:], strict=True):
                    worker.begin(robot, backend, self.states.shape, first, end - first)
            finally:
                os.close(memory)
        self._local = Share(robot, backend, leader)
        self._local.fill(self.states[: ends[1]])
        try:
            for worker in self._remote:
                worker.result()
        except BatchError:
            self.close()
            raise

    def __len__(self) -> int:
        return len(self.states)

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the worker processes. Copies that ran in them cannot be stepped any more."""
        if self._remote:
            self._closing()

    @property
    def dt(self) -> float:
        """Time step in [s]."""
        return self._dt

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joint names in command order."""
        return self._joints

    def array(self, name: str) -> Array:
        """Return the part `name` of State of all copies, a read-only view of shape (N, ...).

        Additional quantities of the scene are called `extra.NAME`. See State for units.

        Raises:
            BatchError: there is no part of that name.
        """
        if name not in self._parts:
            raise BatchError(f"a state has no {name!r}; known: {', '.join(self._parts)}")
        part, shape = self._parts[name]
        return self.states[:, part].reshape(len(self), *shape)

    def command(self, values: ArrayLike, chosen: Chosen = None) -> Array:
        """Set the joint targets of chosen copies; see Simulation.command.

        Args:
            values: One row of positions in [rad] or [m] per chosen copy, shape (k, j).
            chosen: Numbers of the copies.

        Returns:
            The accepted commands, shape (k, j).

        Raises:
            CommandError: another shape, not finite, or refused by the scene; copies before the refused one
                have accepted theirs.
        """
        numbers = self._numbers(chosen)
        rows = float_array(np.asarray(values), (len(numbers), len(self._joints)), "values")
        if not np.isfinite(rows).all():  # each copy checks its row again, when others have accepted theirs
            raise CommandError("commands of a batch refused: one is not finite; nothing was moved")
        parts = self._all("command", numbers, lambda own: (rows[own],))
        accepted = np.empty_like(rows)
        for own, part in parts:
            if len(own):
                accepted[own] = part
        return accepted

    def step(self, steps: int = 1, chosen: Chosen = None) -> list[int]:
        """Advance chosen copies by a number of steps.

        Returns:
            Numbers of the copies that diverged in this call; `failed` contains the reasons.
        """
        numbers = self._numbers(chosen)
        new: dict[int, str] = {}
        for share, (_, part) in enumerate(self._all("step", numbers, lambda _: (int(steps),))):
            new |= {int(self._first[share]) + k: why for k, why in part.items()}
        self.failed |= new
        return sorted(new)

    def reset(self, chosen: Chosen = None) -> None:
        """Return chosen copies to the scene's start with their present parameters; see Simulation.reset."""
        numbers = self._numbers(chosen)
        self._all("reset", numbers, lambda _: ())
        self._clear_failures(numbers)

    def restore(self, snapshot: bytes, chosen: Chosen = None) -> None:
        """Restore a snapshot, with its parameters, of a copy or of a Simulation of the same scene.

        Raises:
            BatchError, SnapshotError: see Simulation.restore.
        """
        numbers = self._numbers(chosen)
        self._all("restore", numbers, lambda _: (snapshot,))
        self._clear_failures(numbers)

    def rebuild(self, number: int, scene: SceneDescription | RobotDescription) -> None:
        """Rebuild a copy from a scene that differs only in numbers, such as masses; it starts again.

        The copy is built again, and reuses the existing plans where all positions and cells are equal.
        Materials and damping can be changed without a rebuild, by `call(number, "set_material", ...)`.

        Raises:
            BatchError: the scene differs in more than numbers, or in its dt; the copy is not changed.
            SceneError, MeshError, MaterialError: the scene cannot be built.
        """
        robot = as_robot(scene)
        if robot.scene.dt != self._dt:
            raise BatchError(
                f"scene {robot.name} has dt {robot.scene.dt}, the batch {self._dt}; all take one dt"
            )
        share, own = self._place(number)
        self._one(share, "rebuild", own, robot)
        self.failed.pop(number, None)

    def call(self, number: int, name: str, *arguments: Any, **named: Any) -> Any:
        """Call a method of a copy's Simulation and return its result, or return an attribute.

        Raises:
            BatchError: the method failed in a worker process. In this process, its own exception is raised.
        """
        share, own = self._place(number)
        return self._one(share, "call", own, name, arguments, named)

    # --- distribution over processes ---

    def _numbers(self, chosen: Chosen) -> IndexArray:
        if chosen is None:
            return np.arange(len(self))
        numbers = np.asarray(chosen, dtype=np.int64).reshape(-1)
        if len(numbers) and not (numbers.min() >= 0 and numbers.max() < len(self)):
            raise BatchError(f"copies {numbers.tolist()}: they are numbered 0 to {len(self) - 1}")
        return numbers

    def _place(self, number: int) -> tuple[int, int]:
        self._numbers([number])
        share = int(np.searchsorted(self._first, number, side="right")) - 1
        return share, number - int(self._first[share])

    def _all(self, name: str, numbers: IndexArray, further: Any) -> list[tuple[IndexArray, Any]]:
        """Call a method of every share with chosen copies; return places in `numbers` and each result."""
        share_of = np.searchsorted(self._first, numbers, side="right") - 1
        own = [np.flatnonzero(share_of == s) for s in range(len(self._first))]
        calls = [
            ((numbers[places] - self._first[s]).tolist(), *further(places)) for s, places in enumerate(own)
        ]
        for worker, arguments in zip(self._remote, calls[1:], strict=True):
            worker.ask(name, arguments)
        error: Exception | None = None
        answers: list[Any] = [None] * len(own)
        try:
            answers[0] = getattr(self._local, name)(*calls[0])
        except Exception as raised:  # read the answers of all workers before raising
            error = raised
        for s, worker in enumerate(self._remote, start=1):
            try:
                answers[s] = worker.result()
            except BatchError as raised:
                error = error or raised
        if error is not None:
            raise error
        return list(zip(own, answers, strict=True))

    def _one(self, share: int, name: str, *arguments: Any) -> Any:
        if share == 0:
            return getattr(self._local, name)(*arguments)
        worker = self._remote[share - 1]
        worker.ask(name, arguments)
        return worker.result()

    def _clear_failures(self, numbers: IndexArray) -> None:
        for number in numbers.tolist():
            self.failed.pop(number, None)


class _Worker:
    """A process that steps a share of the copies.

    Args:
        memory: File descriptor of the states.
    """

    def __init__(self, memory: int) -> None:
        ours, theirs = socket.socketpair()
        with theirs:
            command = python_command(
                "softsim_core.simulation.batch.worker", str(theirs.fileno()), str(memory)
            )
            paths = os.pathsep.join(path for path in sys.path if path)
            self._process = start_process(
                command,
                pass_fds=(theirs.fileno(), memory),
                env={**os.environ, "PYTHONPATH": paths, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
                stdin=subprocess.DEVNULL,
            )
        self._calls = Connection(ours.detach())

    def begin(
        self, robot: RobotDescription, backend: Backend | None, shape: Any, first: int, count: int
    ) -> None:
        """Start to build the copies in the process; `result` waits until they exist.

        Raises:
            BatchError: the scene cannot be sent.
        """
        try:
            data = pickle.dumps((robot, backend, shape, first, count))
        except (pickle.PicklingError, TypeError, AttributeError) as error:
            raise BatchError(
                f"scene {robot.name} cannot be handed to another process ({error}); use workers=1"
            ) from error
        self._calls.send_bytes(data)

    def ask(self, name: str, arguments: Any) -> None:
        """Start a method of the process's Share; a call of `result` must follow."""
        try:
            self._calls.send((name, arguments))
        except OSError as error:
            raise self._gone() from error

    def result(self) -> Any:
        """Wait for the last call and return its result.

        Raises:
            BatchError: the call raised an exception, or the process has ended.
        """
        try:
            good, answer = self._calls.recv()
        except (EOFError, OSError) as error:
            raise self._gone() from error
        if not good:
            raise answer
        return answer

    def _gone(self) -> BatchError:
        return BatchError("a worker process of the batch has ended; create a new batch")

    def close(self) -> None:
        """End the process."""
        self._calls.close()
        try:
            self._process.wait(timeout=5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def _close(workers: list[_Worker]) -> None:
    for worker in workers:
        worker.close()
