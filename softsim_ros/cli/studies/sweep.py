"""`softsim sweep STUDY`: many runs of one scene on all cores or a cluster; one store and a report page."""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from softsim_core.base import StudyError, install_command
from softsim_ros import write_page
from softsim_ros.cli import ProgressLine, UsageError, add_number, add_out, add_words, table_lines

if TYPE_CHECKING:
    from softsim_core.lab.study import PreparedStudy, StudyDescription, StudySummary, SweepOptions

Result = TypeVar("Result")


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "study", nargs="?", help="a study: a file, or the name of a known one; none lists these"
    )
    configure_running(parser)
    parser.add_argument("--parquet", type=Path, metavar="FILE", help="write a table, a row for each run, too")
    parser.add_argument(
        "--report", type=Path, metavar="STORE", help="run nothing; draw a store as a web page, STORE.html"
    )


def configure_running(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments about where the runs are executed."""
    add_out(parser, "STORE", "the store (NAME.zarr in this folder)")
    add_number(parser, "--workers", int, "N", "worker processes (one for each core)")
    parser.add_argument(
        "--scheduler", metavar="ADDRESS", help="run on this Dask cluster, such as tcp://host:8786"
    )
    add_number(parser, "--batch", 1, "N", "runs of one task of Dask (1)")
    add_number(parser, "--bags", 0, "N", "keep recordings of N runs, spread evenly (0)")
    code = "folder whose Python scenes and functions may run; may be given again"
    add_words(parser, "--allow-code", "DIR", code)
    parser.add_argument("--json", action="store_true", help="print what became of it as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Run a study, or draw its store."""
    from softsim_core.lab.study import known_studies, load_study

    if arguments.report is not None:
        return _report(arguments)
    if arguments.study is None:
        for line in table_lines([(name, load_study(file).about) for name, file in known_studies().items()]):
            print(line)
        return 0
    from softsim_core.lab.study import read_results, sweep, write_parquet

    _, summary = run_study(arguments, sweep)
    if arguments.parquet is not None:
        write_parquet(read_results(summary.folder), arguments.parquet)
    print_summary(summary, arguments.json)
    return 0


def run_study(
    arguments: argparse.Namespace, execute: Callable[[PreparedStudy, Path, SweepOptions], Result]
) -> tuple[StudyDescription, Result]:
    """Prepare a study, `execute` it with the options of the arguments, and return it with the result.

    Raises:
        UsageError: one of the given numbers is invalid.
        StudyError: recordings are requested, and ROS or the package that writes them is missing.
    """
    from softsim_core.lab.study import prepare_study

    for option, least in (("workers", 1), ("batch", 1), ("bags", 0)):
        value = getattr(arguments, option)
        if value is not None and value < least:
            raise UsageError(f"--{option} must be {least} or more")
    if arguments.workers is not None and arguments.scheduler is not None:
        raise UsageError("give --workers or --scheduler, not both")
    prepared = prepare_study(arguments.study, arguments.allow_code)
    store = arguments.out or Path(f"{prepared.study.name}.zarr")
    progress = Progress()
    try:
        return prepared.study, execute(prepared, store, _options(arguments, store, progress))
    finally:
        progress.end()


def _options(arguments: argparse.Namespace, store: Path, progress: Progress) -> SweepOptions:
    from softsim_core.lab.study import SweepOptions, Where

    recorder = None
    if arguments.bags:
        for package, extra in (("rosbags", "recording"), ("rclpy", "ros")):
            if importlib.util.find_spec(package) is None:
                raise StudyError(f"--bags needs {package}: {install_command(extra)}")
        from softsim_ros.recording import RunBags

        recorder = RunBags(store.absolute().with_suffix(".bags"))
    workers = arguments.workers or len(os.sched_getaffinity(0))
    where = Where(workers, arguments.scheduler, arguments.batch, progress.line)
    return SweepOptions(where, progress, recorder, arguments.bags)


def print_summary(summary: StudySummary, as_json: bool) -> None:
    """Print the summary of a study."""
    if as_json:
        values = {"store": str(summary.folder), "runs": summary.runs, "new": summary.new}
        print(json.dumps({**values, "counts": summary.counts}))
        return
    counted = ", ".join(f"{count} {word.replace('_', ' ')}" for word, count in summary.counts.items())
    print(f"{summary.folder}: {summary.runs} runs: {counted}; {summary.new} of them now")
    for number, error in summary.first_errors:
        print(f"  run {number}: {error}")
    print(f"look: softsim sweep --report {summary.folder}; read: xarray.open_zarr('{summary.folder}')")


def _report(arguments: argparse.Namespace) -> int:
    from softsim_core.lab.study import read_results, write_parquet
    from softsim_ros.cli.studies.sweep_page import page

    if arguments.study is not None:
        raise UsageError("--report names a store, and no study goes with it")
    results = read_results(arguments.report)
    file = arguments.out or Path(f"{arguments.report.name or 'study'}.html")
    write_page(file, page(results))
    print(f"report: {file}")
    if arguments.parquet is not None:
        write_parquet(results, arguments.parquet)
    return 0


class Progress:
    """A line on the terminal: runs done and failed, rate, remaining time; in a log, one line per minute."""

    def __init__(self) -> None:
        self._line = ProgressLine(sys.stderr, log_period_s=60.0)
        self._begin, self._first, self._last = 0.0, 0, (0, 0, 0)

    def line(self, text: str) -> None:
        """Print a message beside the progress line."""
        print(text, file=sys.stderr, flush=True)

    def __call__(self, done: int, failed: int, total: int) -> None:
        """Show the state after a run."""
        now = time.monotonic()
        if not self._begin:
            self._begin, self._first = now, done
        self._last = (done, failed, total)
        rate = (done - self._first) / max(now - self._begin, 1e-9)
        left = f"{_duration((total - done) / rate)} to go" if rate > 0.0 else ""
        filled = round(20 * done / max(total, 1))
        bar = f"[{'#' * filled}{'.' * (20 - filled)}] {done}/{total} runs"
        self._line.show(f"{bar}, {failed} failed, {rate:.1f} per second, {left}")

    def end(self) -> None:
        """Print the last line."""
        if self._begin:
            done, failed, total = self._last
            spent = time.monotonic() - self._begin
            new = f"{done - self._first} in {spent:.1f} s"
            self._line.end(f"{done}/{total} runs, {failed} failed; {new}")
            self._begin = 0.0


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s" if minutes else f"{rest} s"
