"""The engine of studies: it fills workers that join, and says what is wrong with an address."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from study_files import written
from study_processes import until, workers

from softsim_core.base import StudyError
from softsim_core.lab.study import (
    AHEAD,
    DONE,
    Engine,
    Outcome,
    Where,
    cluster,
    cluster as engine_module,
    engine,
    prepare_study,
)


class Future:
    """A task that ends when the cluster is asked how many workers there are, or at once."""

    status = "finished"

    def __init__(self, batch: list[Any]) -> None:
        self.batch = batch

    def add_done_callback(self, call: Callable[[Any], None]) -> None:
        self.call = call

    def result(self) -> list[Any]:
        return [(number, Outcome(DONE, "", {})) for number, _ in self.batch]


class Cluster:
    """A client of Dask whose workers join one after another."""

    status = "running"

    def __init__(self, threads: list[int]) -> None:
        self.threads, self.under_way, self.most = threads, list[Future](), list[int]()

    def scheduler_info(self, _: int) -> dict[str, Any]:
        count = self.threads.pop(0) if len(self.threads) > 1 else self.threads[0]
        return {"workers": {f"worker {k}": {"nthreads": 1} for k in range(count)}}

    def submit(self, _: Any, work: Any, known: Any, batch: list[Any], *more: Any, pure: bool) -> Future:
        self.under_way.append(Future(batch))
        return self.under_way[-1]

    def end_one(self) -> None:
        self.most.append(len(self.under_way))
        future = self.under_way.pop(0)
        future.call(future)

    def cancel(self, *_: Any, **__: Any) -> None:
        pass


def test_workers_that_join_later_get_tasks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine_module, "LOOK_S", 0.0)
    cluster = Cluster([1, 1, 1, 12])
    found = Engine(cluster, Where())
    asked = found._next

    def ending(ended: Any) -> Any:
        cluster.end_one()
        return asked(ended)

    monkeypatch.setattr(found, "_next", ending)
    monkeypatch.setattr(engine_module, "LOOK_S", 1e-9)
    work = prepare_study(written(tmp_path)).work
    numbers = [number for number, _, _ in found.run(work, ((k, (1.0,)) for k in range(100)), {})]
    assert sorted(numbers) == list(range(100))
    assert max(cluster.most) == 12 * AHEAD
    assert cluster.most[0] <= AHEAD + 12 * AHEAD


@pytest.mark.slow
def test_results_that_die_with_their_worker_are_made_again(tmp_path: Path) -> None:
    """The scheduler says that finished results are lost, before they are fetched."""
    pytest.importorskip("distributed")
    prepared = prepare_study(written(tmp_path, duration=None))
    tasks = [(number, (float(number),)) for number in range(AHEAD)]
    with engine(Where()) as running:
        futures, outcomes = running._client.futures, running.run(prepared.work, tasks, {})
        ended = [next(outcomes)]

        until(lambda: all(each.status == "finished" for each in list(futures.values())))
        os.kill(workers(os.getpid())[0], signal.SIGKILL)
        until(lambda: any(each.status == "lost" for each in list(futures.values())))
        ended += outcomes
    assert [(number, outcome.status) for number, _, outcome in sorted(ended)] == [
        (number, DONE) for number, _ in tasks
    ]


@pytest.mark.parametrize(
    ("address", "told"),
    [
        ("tls://127.0.0.1:1", "certificates in Dask's configuration"),
        ("foo://127.0.0.1:1", "give one such as tcp://"),
        ("tcp://127.0.0.1:x", "give one such as tcp://"),
        ("tcp://", "give one such as tcp://"),
    ],
)
def test_an_address_that_cannot_be_used_is_one_sentence(address: str, told: str) -> None:
    pytest.importorskip("distributed")
    with pytest.raises(StudyError) as refused, engine(Where(scheduler=address)):
        pass
    assert told in str(refused.value)
    assert "\n" not in str(refused.value)


def test_an_interrupt_while_workers_start_waits_and_never_reaches_them() -> None:
    child = "import signal; print(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ()))"
    told: list[str] = []

    def start() -> None:
        with cluster._interrupts_wait():
            os.kill(os.getpid(), signal.SIGINT)
            command = [sys.executable, "-c", child]
            told.append(subprocess.run(command, capture_output=True, text=True, check=True).stdout)

    with pytest.raises(KeyboardInterrupt):
        start()
    assert told == ["True\n"]
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
