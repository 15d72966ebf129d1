"""`softsim calibrate CALIBRATION`: find parameters of a model from measurements, and what they leave open."""

from __future__ import annotations

import argparse
import json
import os
import shlex
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from softsim_ros import write_page
from softsim_ros.cli import EXIT_INTERRUPTED, ProgressLine, UsageError, add_number, add_out
from softsim_ros.cli.measurements.calibrate_report import (
    RequestedResults,
    page,
    plain,
    report_lines,
    write_distribution,
    write_overlay,
)

if TYPE_CHECKING:
    from softsim_core.base import Array
    from softsim_core.lab.identification import Calibration

USUAL_ROUNDS = 5
"""Number of rounds within which most searches end; the remaining time is estimated with it, then plus one."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "calibration",
        nargs="?",
        help="a file, or the name of a data set that comes with one; none lists the known",
    )
    parser.add_argument("--data", type=Path, metavar="DIR", help="folder of the measured files")
    add_number(parser, "--every", int, "N", "only each N-th training row (as the file says)")
    add_out(parser, "YAML", "write the robot with what was found, as a file that extends it")
    parser.add_argument(
        "--report",
        type=Path,
        metavar="HTML",
        help="write a page: intervals within their bounds, correlations, errors of the sessions",
    )
    parser.add_argument(
        "--distribution",
        type=Path,
        metavar="YAML",
        help="write what is left open, as a distribution that sweeps and learning draw from",
    )
    add_number(parser, "--folds", int, "K", "report errors of rows left out, in K folds")
    parser.add_argument(
        "--profile", action="store_true", help="intervals by profile likelihood, some 8 replays for each"
    )
    add_number(
        parser, "--suggest", int, "N", "suggest N poses to measure that would narrow the intervals most"
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Read the calibration, fit, report."""
    from softsim_core.lab.identification import calibrate, data_of, known_calibrations, load_calibration

    if arguments.calibration is None:
        for name in known_calibrations():
            print(name)
        return 0
    for option, smallest in {"every": 1, "folds": 2, "suggest": 1}.items():
        value = getattr(arguments, option)
        if value is not None and value < smallest:
            raise UsageError(f"--{option} must be {smallest} or more")
    for option in ("out", "report", "distribution"):  # reported before a long search, not after it
        value = getattr(arguments, option)
        if value is not None and (value.is_dir() or not value.absolute().parent.is_dir()):
            raise UsageError(f"--{option} {value}: give a file in a folder that is there")
    description, file = load_calibration(arguments.calibration)
    data = data_of(description, file, arguments.data)
    progress = _Progress()
    further = RequestedResults()
    try:
        result = calibrate(description, data, arguments.every, progress, progress.rows)
        if not result.stopped:
            further = _compute_requested(result, arguments, progress)
    finally:
        progress.end()
    if arguments.json:
        print(json.dumps({**plain(result), **further.plain(result)}))
    else:
        print("\n".join([*report_lines(result), *further.report_lines(result)]))
    robot = description.robot or data.robot
    if arguments.out is not None:
        write_overlay(arguments.out, robot, result, further)
        command = ["softsim", "validate", os.path.relpath(data.file.parent), "--robot", str(arguments.out)]
        command += [] if arguments.data is None else ["--data", str(arguments.data)]
        print(f"robot: {arguments.out}; judge it: {shlex.join(command)}", file=sys.stderr)
    if arguments.report is not None:
        write_page(arguments.report, page(robot, result, further))
    if arguments.distribution is not None and not result.stopped:
        write_distribution(arguments.distribution, robot, result)
    return EXIT_INTERRUPTED if result.stopped else 0


def _compute_requested(
    result: Calibration, arguments: argparse.Namespace, progress: _Progress
) -> RequestedResults:
    """Return what the options request; an interrupt leaves out what is not finished."""
    from softsim_core.lab.identification import cross_validated, next_poses, profiled

    further = RequestedResults()
    try:
        if arguments.folds:
            further = replace(further, folds=cross_validated(result, arguments.folds, done=progress.folds))
        if arguments.profile:
            ends = [profiled(result, k) for k in range(len(result.values))]
            further = replace(further, intervals=ends)
        if arguments.suggest:
            further = replace(further, poses=next_poses(result, arguments.suggest, done=progress.candidates))
    except KeyboardInterrupt:
        print("softsim calibrate: interrupted; what was not done is left out", file=sys.stderr)
    return further


class _Progress:
    """A line on the terminal: progress, and size of the error."""

    def __init__(self) -> None:
        self._line, self._begin = ProgressLine(sys.stderr), time.monotonic()
        self._count, self._best = 0, np.inf

    def rows(self, done: int, total: int) -> None:
        if done % 10 == 0 or done == total:
            self._line.show(f"finding all rows once: {done}/{total}", at_once=True)

    def folds(self, done: int, total: int) -> None:
        self._line.show(f"folds: {done}/{total}", at_once=True)

    def candidates(self, done: int, total: int) -> None:
        self._line.show(f"candidates: {done}/{total} replays", at_once=True)

    def __call__(self, count: int, mean: float, values: Array) -> None:
        self._count, self._best = count, min(self._best, mean)
        spent, size = (time.monotonic() - self._begin) / count, len(values) + 1
        now = count // size + 1  # a round takes one replay per value for the slopes, and a step
        rounds = max(USUAL_ROUNDS, now + 1)
        left = spent * (rounds * size - count)
        line = f"round {now} of some {rounds}, {count} replays, best mean {1e3 * self._best:.3f} mm, "
        self._line.show(f"{line}about {left / 60.0:.0f} min to go", at_once=True)

    def end(self) -> None:
        if self._count:
            spent = time.monotonic() - self._begin
            self._line.end(f"{self._count} replays in {spent:.0f} s, best mean {1e3 * self._best:.3f} mm")
