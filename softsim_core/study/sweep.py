"""All runs of a study into its store, going on where an earlier start ended."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from softsim_core.study.design import values_of_runs
from softsim_core.study.engine import Engine, Recorder, Task, Where, engine
from softsim_core.study.preparing import PreparedStudy
from softsim_core.study.single import DONE, STATUS_WORDS, Work
from softsim_core.study.store import Store

Progress = Callable[[int, int, int], None]
"""Told how many runs are done, how many of these failed, and how many there are in all."""


@dataclass(frozen=True, slots=True)
class SweepOptions:
    """How a study is run.

    Attributes:
        where: On which workers.
        progress: Told of every run.
        recorder: Makes recordings; None: none are made.
        recordings: Of how many runs, spread evenly over the study.
    """

    where: Where = field(default_factory=Where)
    progress: Progress = lambda done, failed, total: None
    recorder: Recorder | None = None
    recordings: int = 0

    def recorded(self, runs: int) -> dict[int, Recorder]:
        """Recorders by the number of their run."""
        if self.recorder is None or self.recordings < 1:
            return {}
        chosen = np.linspace(0, runs - 1, min(self.recordings, runs)).round().astype(int)
        return dict.fromkeys(chosen.tolist(), self.recorder)


@dataclass(frozen=True, slots=True)
class StudySummary:
    """What became of a study.

    Attributes:
        folder: Its store.
        runs: How many there are in all.
        new: How many of them were run now.
        counts: How many became what, by words such as "diverged".
        first_errors: Some runs that failed, and why.
    """

    folder: Path
    runs: int
    new: int
    counts: Mapping[str, int]
    first_errors: tuple[tuple[int, str], ...]


def sweep(prepared: PreparedStudy, folder: Path, options: SweepOptions | None = None) -> StudySummary:
    """Run all of a study that is not done yet.

    Args:
        prepared: The study.
        folder: Its store.
        options: How; None: one worker on this machine.

    Raises:
        StudyError: the store is another study's or cannot be written, or the scheduler went away.
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


def run_into(store: Store, cluster: Engine, work: Work, tasks: Iterable[Task], options: SweepOptions) -> None:
    """Run some tasks, and keep what became of them."""
    done = len(store.status) - len(store.left)
    failed = int((store.status > DONE).sum())
    options.progress(done, failed, len(store.status))
    for number, values, outcome in cluster.run(work, tasks, options.recorded(len(store.status))):
        store.add(number, dict(zip(work.names, values, strict=True)), outcome)
        done, failed = done + 1, failed + (outcome.status != DONE)
        options.progress(done, failed, len(store.status))


def summary_of(store: Store, new: int) -> StudySummary:
    """What became of the study in a store, of which `new` runs were run now."""
    counts = Counter(STATUS_WORDS[status] for status in store.status.tolist())
    failed = np.flatnonzero(store.status > DONE)[:5].tolist()
    errors = store.errors() if failed else []
    return StudySummary(
        store.folder,
        len(store.status),
        new,
        {word: counts[word] for word in STATUS_WORDS if counts[word]},
        tuple((number, errors[number]) for number in failed),
    )
