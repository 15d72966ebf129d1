"""Execution of a study's runs on the worker processes of a Dask cluster, with results in its store."""

from __future__ import annotations

import contextlib
import functools
import importlib
import logging
import os
import queue
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import islice
from multiprocessing import resource_tracker
from pathlib import Path
from time import monotonic
from typing import Any, TypeAlias

import numpy as np

from softsim_core.base import THREAD_VARIABLES, SoftSimError, StudyError, install_command, use_safe_path
from softsim_core.lab.study.preparing import PreparedStudy, values_of_runs
from softsim_core.lab.study.single import DONE, RAISED, Outcome, Watch, Work, run_once
from softsim_core.lab.study.store import Store, count_runs, versions
from softsim_core.scene import load_scene
from softsim_core.scene.io import ProgramRule, limited_to
from softsim_core.simulation import Simulation

AHEAD = 3
"""Waiting tasks per worker thread: the scheduler never has more than these of a study."""

WAIT_FOR_WORKERS_S = 60.0
LOOK_S = 1.0
KILLED = "its worker process was killed, again and again (out of memory, or a crash of compiled code)"


Recorder: TypeAlias = Callable[[Work, int], tuple[Watch, Callable[[], None]]]
"""Starts the recording of a run by its number; returns the functions to call after each step and at the end.

It is sent to the processes that execute the runs.
"""


@dataclass(frozen=True, slots=True)
class Where:
    """Location of the runs.

    Attributes:
        workers: Worker processes on this machine, one thread each.
        scheduler: Address of a Dask scheduler in their place; None: there is none.
        batch: Runs per task.
        told: Called once with a line about the cluster.
    """

    workers: int = 1
    scheduler: str | None = None
    batch: int = 1
    told: Callable[[str], None] = lambda _: None


Task: TypeAlias = tuple[int, tuple[float, ...]]
"""A run: its number, and the values of the variables."""


def run_batch(
    work: Work, expected: Mapping[str, str], tasks: Sequence[Task], recorded: Mapping[int, Recorder]
) -> list[tuple[int, Outcome]]:
    """Execute some runs one after another, in a worker process.

    Args:
        work: Common data of the runs.
        expected: Versions of packages where the study was started; others could change bits of the results.
        tasks: The runs.
        recorded: Recorders of some of them, by run number.

    Raises:
        StudyError: this process has other versions.
    """
    differing = [name for name, version in versions().items() if expected.get(name) != version]
    if differing:
        name = differing[0]
        raise StudyError(
            f"a worker has {name} {versions()[name]}, the client {expected.get(name)}; install the same"
        )
    _load_kernels(work.scene, work.programs)
    return [(number, _recorded_run(work, number, values, recorded.get(number))) for number, values in tasks]


@functools.lru_cache(maxsize=1)
def _load_kernels(scene: Path, programs: ProgramRule) -> None:
    """Load compiled kernels once per process, so that these seconds do not count in a run's time limit."""
    with contextlib.suppress(SoftSimError), limited_to(programs):
        Simulation(load_scene(scene)).step()


def _recorded_run(work: Work, number: int, values: Sequence[float], recorder: Recorder | None) -> Outcome:
    if recorder is None:
        return run_once(work, values)
    try:
        watch, end = recorder(work, number)
    except Exception as error:
        return Outcome(RAISED, f"its recording cannot be made: {error}", {})
    try:
        return run_once(work, values, watch)
    finally:
        end()


class Engine:
    """A running cluster, with its client of Dask; `run` yields outcomes as they arrive."""

    def __init__(self, client: Any, where: Where) -> None:
        self._client, self._where = client, where
        self._most = AHEAD
        self._counted: float | None = None

    def run(
        self, work: Work, tasks: Iterable[Task], recorded: Mapping[int, Recorder]
    ) -> Iterator[tuple[int, tuple[float, ...], Outcome]]:
        """Yield number, values and outcome of each run, in the order in which they end.

        Raises:
            StudyError: the scheduler or all workers disappeared, or workers cannot run the suite.
        """
        suspects: list[Task] = []
        source = iter(tasks)
        batches = iter(lambda: list(islice(source, self._where.batch)), [])
        yield from self._pass(work, batches, recorded, self._free_slots, suspects)
        alone, guilty = [[each] for each in suspects], list[Task]()
        yield from self._pass(work, iter(alone), recorded, lambda: 1, guilty)
        for number, values in guilty:
            yield number, values, Outcome(RAISED, KILLED, {})

    def _free_slots(self) -> int:
        """Return the number of tasks for the present workers, counted every LOOK_S as some may join."""
        if self._counted is None or monotonic() - self._counted >= LOOK_S:
            with contextlib.suppress(OSError, TimeoutError):  # `_next` detects a lost scheduler
                workers = self._client.scheduler_info(-1)["workers"].values()
                self._most = AHEAD * max(1, sum(int(each["nthreads"]) for each in workers))
            self._counted = monotonic()
        return self._most

    def _pass(
        self,
        work: Work,
        waiting: Iterator[list[Task]],
        recorded: Mapping[int, Recorder],
        most: Callable[[], int],
        suspects: list[Task],
    ) -> Iterator[tuple[int, tuple[float, ...], Outcome]]:
        """Run batches, at most `most` at a time; runs whose workers were killed are added to `suspects`.

        A run on a worker that another run killed is not at fault. Suspects therefore run alone on a worker.
        """
        ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
        under_way: dict[Any, list[Task]] = {}
        installed = versions()

        def fill() -> None:
            while len(under_way) < most() and (batch := next(waiting, None)) is not None:
                chosen = {number: recorded[number] for number, _ in batch if number in recorded}
                future = self._client.submit(run_batch, work, installed, batch, chosen, pure=False)
                under_way[future] = batch
                future.add_done_callback(ended.put)

        try:
            fill()
            while under_way:
                if (future := self._next(ended)) is None:
                    fill()
                    continue
                batch = under_way.pop(future)
                outcomes = self._outcomes(future)
                fill()
                if outcomes is None:
                    suspects += batch
                    continue
                values = dict(batch)
                for number, outcome in outcomes:
                    yield number, values[number], outcome
        finally:
            if self._client.status == "running":
                self._client.cancel(list(under_way), force=True)

    def _next(self, ended: queue.SimpleQueue[Any]) -> Any:
        """Return a task that has ended; None: none ended within LOOK_S."""
        if self._client.status != "running":
            raise self._gone()
        try:
            return ended.get(timeout=LOOK_S)
        except queue.Empty:
            return None

    def _outcomes(self, future: Any) -> list[tuple[int, Outcome]] | None:
        """Return the results of a task; None: its workers were killed."""
        if future.status == "finished":
            try:
                outcomes: list[tuple[int, Outcome]] = future.result()
            except Exception as error:
                if self._client.status == "running":  # the worker was killed with its result
                    return None
                raise self._gone() from error
            return outcomes
        if future.status == "lost":  # the same, and the scheduler has noticed it first
            return None
        if future.status == "cancelled":
            raise self._gone()
        raised = future.exception()
        if type(raised).__name__ == "KilledWorker":
            return None
        said = str(raised) if isinstance(raised, StudyError) else f"{type(raised).__name__}: {raised}"
        raise StudyError(f"the workers cannot run the study: {said}")

    def _gone(self) -> StudyError:
        where = self._where.scheduler or "on this machine"
        return StudyError(
            f"the Dask scheduler {where} went away; what was done is kept, and the same command continues "
            "when it is back"
        )


@contextmanager
def engine(where: Where) -> Iterator[Engine]:
    """Provide a cluster within the `with` block: local worker processes, which end with it, or a scheduler's.

    Raises:
        StudyError: Dask is not installed, or the scheduler cannot be reached or has no workers.
    """
    try:
        distributed = importlib.import_module("distributed")
        dask = importlib.import_module("dask")
        if where.scheduler is None:
            importlib.import_module("cryptography")
    except ImportError as error:
        raise StudyError(
            f"studies need Dask and Zarr 3 (Python 3.11 or newer): {install_command('study')}"
        ) from error
    # one thread per worker, as workers fill the cores and sums need a fixed order
    environment = dict.fromkeys(THREAD_VARIABLES, "1")
    settings = {
        "distributed.nanny.pre-spawn-environ": {**environment, "MALLOC_TRIM_THRESHOLD_": "65536"},
        "distributed.scheduler.allowed-failures": 1,
        "distributed.worker.profile.enabled": False,
        "distributed.admin.tick.limit": "60s",
        "distributed.comm.timeouts.connect": "10s",
    }
    with dask.config.set(settings):
        if where.scheduler is not None:
            with _connect_to_scheduler(distributed, where) as client:
                yield Engine(client, where)
            return
        os.environ.update(environment)  # inherited by new worker processes
        use_safe_path()
        with contextlib.ExitStack() as stack:
            with _interrupts_wait():
                cluster = stack.enter_context(
                    distributed.LocalCluster(
                        n_workers=where.workers,
                        threads_per_worker=1,
                        processes=True,
                        memory_limit=0,
                        protocol="tls://",  # others on this machine cannot have the workers run their code
                        security=distributed.Security.temporary(),
                        host="127.0.0.1",
                        dashboard_address="127.0.0.1:0",
                        silence_logs=logging.CRITICAL,
                    )
                )
                client = stack.enter_context(distributed.Client(cluster, set_as_default=False))
            where.told(f"{where.workers} worker processes; dashboard: {cluster.dashboard_link}")
            yield Engine(client, where)


@contextmanager
def _interrupts_wait() -> Iterator[None]:
    """Block Ctrl-C until the end of the block, also in the processes that are started in it.

    A terminal also interrupts the workers, which would print long tracebacks. They inherit the blocked signal
    from the thread that starts them, and the client ends them. Dask cannot be interrupted while it starts.
    """
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "pthread_sigmask"):
        yield
        return
    came: list[int] = []
    resource_tracker.ensure_running()  # else the first process would start it, and unblock interrupts
    before = signal.signal(signal.SIGINT, lambda number, _: came.append(number))
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        signal.signal(signal.SIGINT, before)
        if came:
            signal.raise_signal(signal.SIGINT)


@contextmanager
def _connect_to_scheduler(distributed: Any, where: Where) -> Iterator[Any]:
    """Connect to a scheduler that has workers, and yield the client."""
    # these log a lost scheduler at length
    for name in ("distributed", "distributed.client", "distributed.core", "asyncio", "tornado"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        client = distributed.Client(where.scheduler, timeout="10s", set_as_default=False)
    except (OSError, TimeoutError) as error:
        raise StudyError(
            f"no Dask scheduler answers at {where.scheduler}; start one (dask scheduler), or leave out "
            "--scheduler"
        ) from error
    except Exception as error:  # each transport raises its own errors for an invalid address
        if str(where.scheduler).startswith(("tls://", "wss://")):
            hint = "name its certificates in Dask's configuration (distributed.comm.tls)"
        else:
            hint = "give one such as tcp://192.168.0.2:8786"
        said = " ".join(str(error).split())
        raise StudyError(f"the scheduler {where.scheduler} cannot be used ({said}); {hint}") from error
    try:
        try:
            client.wait_for_workers(1, timeout=WAIT_FOR_WORKERS_S)
        except Exception as error:
            raise StudyError(
                f"the scheduler {where.scheduler} has no workers after {WAIT_FOR_WORKERS_S:g} s; start some "
                "(dask worker ADDRESS --nthreads 1)"
            ) from error
        where.told(f"scheduler {where.scheduler}; dashboard: {client.dashboard_link}")
        yield client
    finally:
        client.close(timeout=2)


Progress = Callable[[int, int, int], None]
"""Called with the numbers of finished, failed and all runs."""


@dataclass(frozen=True, slots=True)
class SweepOptions:
    """Options of a study's execution.

    Attributes:
        where: Location of the workers.
        progress: Called after every run.
        recorder: Creates recordings; None: none are made.
        recordings: Number of recorded runs, spread evenly over the study.
    """

    where: Where = field(default_factory=Where)
    progress: Progress = lambda done, failed, total: None
    recorder: Recorder | None = None
    recordings: int = 0

    def choose_recorders(self, runs: int) -> dict[int, Recorder]:
        """Return recorders by run number."""
        if self.recorder is None or self.recordings < 1:
            return {}
        chosen = np.linspace(0, runs - 1, min(self.recordings, runs)).round().astype(int)
        return dict.fromkeys(chosen.tolist(), self.recorder)


@dataclass(frozen=True, slots=True)
class StudySummary:
    """Summary of a study's runs.

    Attributes:
        folder: Its store.
        runs: Total number of runs.
        new: Number of runs executed now.
        counts: Number of runs by status word, such as "diverged".
        first_errors: Some failed runs with the reasons.
    """

    folder: Path
    runs: int
    new: int
    counts: Mapping[str, int]
    first_errors: tuple[tuple[int, str], ...]


def sweep(prepared: PreparedStudy, folder: Path, options: SweepOptions | None = None) -> StudySummary:
    """Run all of a study that is not done yet into its store; without options, by one worker here.

    Raises:
        StudyError: the store is another study's or cannot be written, or the scheduler disappeared.
        SoftSimError: the scene with the first values cannot be built.
    """
    options = SweepOptions() if options is None else options
    values = values_of_runs(prepared.study)
    plan = prepared.plan(len(values), prepared.study.block, values[0])
    with Store(folder, plan) as store:
        left = store.left
        if left:
            tasks: Iterable[Task] = ((number, tuple(values[number].tolist())) for number in left)
            with engine(options.where) as cluster:
                run_into(store, cluster, prepared.work, tasks, options)
        return summary_of(store, len(left))


def run_into(
    store: Store,
    cluster: Engine,
    work: Work,
    tasks: Iterable[Task],
    options: SweepOptions,
    rate: Callable[[Mapping[str, float], Outcome], Outcome] = lambda values, outcome: outcome,
) -> None:
    """Execute some tasks, and store their outcomes; `rate` completes each with the values of its run."""
    runs, failed = len(store.status), int((store.status > DONE).sum())
    done = runs - len(store.left)
    options.progress(done, failed, runs)
    for number, values, outcome in cluster.run(work, tasks, options.choose_recorders(runs)):
        named = dict(zip(work.names, values, strict=True))
        outcome = rate(named, outcome)
        store.add(number, named, outcome)
        done, failed = done + 1, failed + (outcome.status != DONE)
        options.progress(done, failed, runs)


def summary_of(store: Store, new: int) -> StudySummary:
    """Return the summary of a store, of which `new` runs were executed now."""
    failed = np.flatnonzero(store.status > DONE)[:5].tolist()
    errors = store.errors() if failed else []
    return StudySummary(
        store.folder,
        len(store.status),
        new,
        count_runs(store.status),
        tuple((number, errors[number]) for number in failed),
    )
