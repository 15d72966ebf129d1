"""`softsim calibrate CALIBRATION`: find parameters of a model from measurements, and say what is not told."""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from softsim_ros.cli.validate import EXIT_INTERRUPTED

if TYPE_CHECKING:
    from softsim_core.arrays import Array
    from softsim_core.identification.calibration import Calibration

TOGETHER = 0.9
"""From this correlation on two parameters are told together only."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "calibration",
        nargs="?",
        help="a file, or the name of a data set that comes with one; none lists the known",
    )
    parser.add_argument("--data", type=Path, metavar="DIR", help="folder of the measured files")
    parser.add_argument(
        "--every", type=int, metavar="N", help="only each N-th training row (as the file says)"
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="YAML",
        help="write the robot with what was found, as a file that extends it",
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Read, fit, tell."""
    from softsim_core.identification.calibration import (
        calibrate,
        data_of,
        known_calibrations,
        load_calibration,
    )

    if arguments.calibration is None:
        for name in known_calibrations():
            print(name)
        return 0
    if arguments.every is not None and arguments.every < 1:
        print("softsim calibrate: --every must be 1 or more", file=sys.stderr)
        return 2
    description, file = load_calibration(arguments.calibration)
    data = data_of(description, file, arguments.data)
    progress = _Progress(len(description.parameters))
    try:
        result = calibrate(description, data, arguments.every, progress, progress.rows)
    finally:
        progress.end()
    if arguments.json:
        print(json.dumps(plain(result)))
    else:
        print("\n".join(sentences(result)))
    if arguments.out is not None:
        robot = description.robot or data.robot
        write_overlay(arguments.out, robot, result)
        print(f"robot: {arguments.out}; judge it: softsim validate --robot {arguments.out}", file=sys.stderr)
    return EXIT_INTERRUPTED if result.stopped else 0


def sentences(result: Calibration) -> list[str]:
    """What was found, as lines for people."""
    from softsim_core.identification.calibration import QUANTILE

    lines = ["interrupted: the best that was tried follows"] if result.stopped else []
    wanted = result.description.parameters
    width = max(len(each.name) for each in wanted)
    for k, each in enumerate(wanted):
        half = QUANTILE * result.errors[k]
        found = f"+- {half:.3g}" if np.isfinite(half) else "+- ?"
        told = f"{each.name:<{width}}  {result.values[k]:>10.4g} {found:<11} {each.unit:<12}"
        lines.append(f"{told} began at {each.start:g}{_verdict(result, k)}")
    lines += [
        f"{one} and {other} are told together only: correlation {value:+.2f}"
        for one, other, value in together(result)
    ]
    lines += [
        f"session {name}: {count} rows, mean error {1e3 * result.before[name]:.3f} mm before, "
        f"{1e3 * result.after[name]:.3f} mm after"
        for name, count in result.rows.items()
    ]
    return lines


def _verdict(result: Calibration, k: int) -> str:
    if result.stopped:
        return ""
    if not result.found[k]:
        return "  NOT FOUND: these rows do not tell it"
    return "  at its bound" if result.at_bounds[k] else ""


def together(result: Calibration) -> list[tuple[str, str, float]]:
    """Pairs of parameters that are hard to tell apart, and their correlation."""
    names = [each.name for each in result.description.parameters]
    return [
        (names[i], names[j], float(result.correlation[i, j]))
        for i in range(len(names))
        for j in range(i + 1, len(names))
        if abs(result.correlation[i, j]) > TOGETHER
    ]


def plain(result: Calibration) -> dict[str, Any]:
    """The result as plain data: what cannot be told is null."""

    def number(value: float) -> float | None:
        return float(value) if np.isfinite(value) else None

    return {
        "name": result.description.name,
        "parameters": [
            {
                "name": each.name,
                "unit": each.unit,
                "value": float(result.values[k]),
                "standard_error": number(result.errors[k]),
                "found": bool(result.found[k]),
                "at_bound": bool(result.at_bounds[k]),
            }
            for k, each in enumerate(result.description.parameters)
        ],
        "correlation": [[number(each) for each in row] for row in result.correlation.tolist()],
        "sessions": {
            name: {
                "rows": count,
                "mean_before_mm": 1e3 * result.before[name],
                "mean_after_mm": 1e3 * result.after[name],
            }
            for name, count in result.rows.items()
        },
        "evaluations": result.evaluations,
        "interrupted": result.stopped,
        "overlay": result.overlay,
    }


def write_overlay(file: Path, robot: str, result: Calibration) -> None:
    """A scene file that extends the robot by what was found."""
    import yaml

    from softsim_core import find_config

    base = os.path.relpath(find_config(robot), file.absolute().parent)
    told = [f"# {line}" for line in sentences(result)]
    text = yaml.safe_dump({"extends": base, **result.overlay}, sort_keys=False, default_flow_style=None)
    file.write_text("\n".join([f"# Found by softsim calibrate {result.description.name}.", *told, text]))


class _Progress:
    """A line on the terminal: how often all rows were replayed, how large the error is, which values."""

    def __init__(self, parameters: int) -> None:
        self._shown, self._begin, self._count, self._best = sys.stderr.isatty(), time.monotonic(), 0, np.inf
        self._per_round = parameters + 1

    def rows(self, done: int, total: int) -> None:
        """Told how many rows of a session have been found once."""
        if self._shown and (done % 10 == 0 or done == total):
            print(f"\r{f'finding all rows once: {done}/{total}':<78}", end="", file=sys.stderr, flush=True)

    def __call__(self, count: int, mean: float, values: Array) -> None:
        self._count, self._best = count, min(self._best, mean)
        spent = time.monotonic() - self._begin
        if self._shown:
            line = (
                f"round {count // self._per_round}, {count} replays, {spent / count:.1f} s each, best mean "
                f"{1e3 * self._best:.3f} mm"
            )
            print(f"\r{line:<78}", end="", file=sys.stderr, flush=True)

    def end(self) -> None:
        if self._count:
            spent = time.monotonic() - self._begin
            line = f"{self._count} replays in {spent:.0f} s, best mean {1e3 * self._best:.3f} mm"
            print(f"\r{line:<78}" if self._shown else line, file=sys.stderr)
