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
    """See the module.

    Args:
        robot: What each is a copy of.
        backend: See Simulation.
        leader: The first copy, where it is built already.
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
        """Make a copy for each row of `states` (k, s), which its state lives in from now on."""
        for row in states:
            copy = Simulation(self._robot, self._backend, self._leader) if self._copies else self._leader
            copy.keep_state_in(row)
            self._copies.append(copy)
            self._states.append(row)

    def command(self, chosen: Sequence[int], values: Array) -> list[Array]:
        """See Simulation.command, of each chosen copy its row of `values`; what each accepted."""
        return [self._copies[k].command(row) for k, row in zip(chosen, values, strict=True)]

    def step(self, chosen: Sequence[int], steps: int) -> dict[int, str]:
        """Advance each chosen copy by so many steps; of those that diverged, why.

        They stay at their last good state, and are passed over until they are reset.
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
        """See Simulation.reset."""
        for k in chosen:
            self._copies[k].reset()
        self._failed.difference_update(chosen)

    def restore(self, chosen: Sequence[int], snapshot: bytes) -> None:
        """See Simulation.restore."""
        for k in chosen:
            self._copies[k].restore(snapshot)
        self._failed.difference_update(chosen)

    def rebuild(self, k: int, robot: RobotDescription) -> None:
        """Make a copy one of a scene that differs in numbers; it begins anew.

        Raises:
            BatchError: it differs in more; the copy stays what it was.
            SceneError, MeshError, MaterialError: the scene cannot be built.
        """
        copy = Simulation(robot, self._backend, self._leader)
        if copy.state_parts != self._leader.state_parts or copy.joint_names != self._leader.joint_names:
            raise BatchError(
                f"scene {robot.name} has other nodes, frames, joints or bodies than the batch's; "
                "change numbers only, or make a batch of its own"
            )
        if k:
            copy.keep_state_in(self._states[k])
            self._copies[k] = copy
        else:  # the others go on sharing what the first one has planned
            copy.keep_state_in(self._states[0])
            self._copies[0] = copy
        self._failed.discard(k)

    def call(self, k: int, name: str, arguments: Sequence[Any], named: Mapping[str, Any]) -> Any:
        """What a method of a copy gives, or one of its attributes."""
        found = getattr(self._copies[k], name)
        return found(*arguments, **named) if callable(found) else found


def failure(error: Exception) -> Exception:
    """An error as it may be sent to another process: one of the suite's own, or a sentence."""
    if isinstance(error, SoftSimError) and error.args and len(error.args) == 1:
        own = BatchError(str(error))
        own.__cause__ = None
        return own
    return BatchError(f"{type(error).__name__}: {error}")


Chosen = Sequence[int] | IndexArray | None
"""Numbers of copies; None: all of them."""


class Batch:
    """Copies of a scene: what was built and planned is shared, and the room to work in; nothing that changes.

    Each copy gives the same bytes as a Simulation that got the same commands, whatever the number of workers
    and of copies. A step holds Python's lock for a fifth of its time to two thirds (with contact), so copies
    run on several cores in processes, not in threads; states lie in memory that all of them see.

    Args:
        scene: What each is a copy of.
        copies: How many, >= 1.
        workers: On how many cores; 1: all here, without another process.
        backend: See Simulation.

    Attributes:
        states: State.buffer of each copy, to be read, shape (N, s); see `array`.
        failed: Why copies have diverged, by their numbers. They stand still until they are reset.

    Raises:
        BatchError: a wrong number, or a scene that cannot be handed to another process.
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

    def __enter__(self) -> Batch:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the worker processes; the copies cannot be stepped any more where there were some."""
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
        """What State calls `name`, of all copies, a view to be read, shape (N, ...); see State for units.

        What the scene keeps beside is called `extra.NAME`.

        Raises:
            BatchError: there is nothing of that name.
        """
        if name not in self._parts:
            raise BatchError(f"a state has no {name!r}; known: {', '.join(self._parts)}")
        part, shape = self._parts[name]
        return self.states[:, part].reshape(len(self), *shape)

    def command(self, values: ArrayLike, chosen: Chosen = None) -> Array:
        """Set where the joints go; see Simulation.command.

        Args:
            values: A row of positions in [rad] or [m] for each chosen copy, shape (k, j).
            chosen: Which copies.

        Returns:
            The accepted commands, shape (k, j).

        Raises:
            CommandError: another shape, not finite, or refused by the scene; copies before it have taken
                theirs.
        """
        numbers = self._numbers(chosen)
        rows = float_array(np.asarray(values), (len(numbers), len(self._joints)), "values")
        if not np.isfinite(rows).all():
            raise CommandError("commands of a batch refused: one is not finite; nothing was moved")
        parts = self._all("command", numbers, lambda own: (rows[own],))
        accepted = np.empty_like(rows)
        for own, part in parts:
            if len(own):
                accepted[own] = part
        return accepted

    def step(self, steps: int = 1, chosen: Chosen = None) -> list[int]:
        """Advance chosen copies by so many steps.

        Returns:
            Those that have diverged now; `failed` says why.
        """
        numbers = self._numbers(chosen)
        new: dict[int, str] = {}
        for share, (_, part) in enumerate(self._all("step", numbers, lambda _: (int(steps),))):
            new |= {int(self._first[share]) + k: why for k, why in part.items()}
        self.failed |= new
        return sorted(new)

    def reset(self, chosen: Chosen = None) -> None:
        """Back to the start of the scene, with the parameters as they are; see Simulation.reset."""
        numbers = self._numbers(chosen)
        self._all("reset", numbers, lambda _: ())
        self._recovered(numbers)

    def restore(self, snapshot: bytes, chosen: Chosen = None) -> None:
        """Go on from a snapshot, of a copy or of a Simulation of the same scene; parameters come with it.

        Raises:
            BatchError, SnapshotError: see Simulation.restore.
        """
        numbers = self._numbers(chosen)
        self._all("restore", numbers, lambda _: (snapshot,))
        self._recovered(numbers)

    def rebuild(self, number: int, scene: SceneDescription | RobotDescription) -> None:
        """Make a copy one of a scene that differs in numbers, such as masses or friction; it begins anew.

        It is built again, and takes over what is planned where no place and no cell differs. Materials and
        damping are changed without that, by `call(number, "set_material", ...)`.

        Raises:
            BatchError: it differs in more than numbers, or its dt; the copy stays what it was.
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
        """What a method of Simulation gives for a copy, or one of its attributes, by name.

        Raises:
            BatchError: another process runs the copy, and there the method failed; in this process
                whatever it raised comes as it is.
        """
        share, own = self._place(number)
        return self._one(share, "call", own, name, arguments, named)

    # --- where copies are ---

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
        """Call every share with the copies that it has; for each, places in `numbers` and its answer."""
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
        except Exception as raised:  # the workers' answers are taken first
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

    def _recovered(self, numbers: IndexArray) -> None:
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
        """Have it make its copies; `result` tells when it has.

        Raises:
            BatchError: the scene cannot be handed over.
        """
        try:
            data = pickle.dumps((robot, backend, shape, first, count))
        except (pickle.PicklingError, TypeError, AttributeError) as error:
            raise BatchError(
                f"scene {robot.name} cannot be handed to another process ({error}); use workers=1"
            ) from error
        self._calls.send_bytes(data)

    def ask(self, name: str, arguments: Any) -> None:
        """Call a method of its Share; `result` has to follow."""
        try:
            self._calls.send((name, arguments))
        except OSError as error:
            raise self._gone() from error

    def result(self) -> Any:
        """What the last call gave.

        Raises:
            BatchError: it raised something, or the process has ended.
        """
        try:
            good, answer = self._calls.recv()
        except (EOFError, OSError) as error:
            raise self._gone() from error
        if not good:
            raise answer
        return answer

    def _gone(self) -> BatchError:
        return BatchError("a worker process of the batch has ended; make the batch anew")

    def close(self) -> None:
        """End it."""
        self._calls.close()
        try:
            self._process.wait(timeout=5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def _close(workers: list[_Worker]) -> None:
    for worker in workers:
        worker.close()
