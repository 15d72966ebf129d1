"""`softsim validate DATASET`: compare a model with measurements of the real robot, or of another model."""

from __future__ import annotations

import argparse
import importlib.util
import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from softsim_core.base import DataError, known_names
from softsim_ros import write_page
from softsim_ros.cli import (
    EXIT_INTERRUPTED,
    ProgressLine,
    UsageError,
    add_number,
    add_out,
    add_words,
    table_lines,
)

if TYPE_CHECKING:
    from softsim_core.lab.identification import DataSet, Session, SessionResult

LIMITS = ("mean", "rms", "p95", "max")


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "data_set", nargs="?", help="a data set: a name, or a folder with dataset.yaml; none lists the known"
    )
    parser.add_argument("--robot", metavar="MODEL", help="robot or scene: a name or a file (the data set's)")
    parser.add_argument("--data", type=Path, metavar="DIR", help="folder of the measured files")
    add_words(parser, "--session", "NAME", "only this session; may be given again")
    add_number(parser, "--every", 1, "N", "only each N-th row, for a first look (1)")
    parser.add_argument(
        "--order",
        choices=("nearest", "rows"),
        help="of static rows (rows of a run that has an order, else nearest)",
    )
    parser.add_argument(
        "--alignment",
        type=Path,
        metavar="JSON",
        help="frames and sensor points of an earlier report, fit none",
    )
    parser.add_argument("--others-only", action="store_true", help="run no model, compare the other models'")
    for name in LIMITS:
        about = f"largest {name} error of a session that passes, in mm"
        add_number(parser, f"--max-{name}", float, "MM", about)
    add_out(parser, "HTML", "write a report as a web page")
    parser.add_argument("--json", action="store_true", help="print the report as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Read, replay, align, compare."""
    from softsim_core.lab.identification import known_data_sets, load_data_set, plain
    from softsim_ros.cli.measurements.validate_report import report_lines, validation_page

    if arguments.data_set is None:
        data_sets = known_data_sets().items()
        for line in table_lines([(name, load_data_set(file).description.about) for name, file in data_sets]):
            print(line)
        return 0
    limits = {f"{name}_mm": getattr(arguments, f"max_{name}") for name in LIMITS}
    limits = {name: value for name, value in limits.items() if value is not None}
    if arguments.every < 1 or not all(value > 0.0 for value in limits.values()):
        raise UsageError("--every must be 1 or more, limits must be > 0 mm")
    if importlib.util.find_spec("rosbags") is not None:
        from softsim_ros.recording import register

        register()
    data = load_data_set(arguments.data_set, arguments.data)
    model = None if arguments.others_only else arguments.robot or data.robot
    results, failed, interrupted = _results(arguments, data, model, limits)
    if arguments.json:
        print(json.dumps(plain(data.description.name, model, results)))
    else:
        print("\n".join(report_lines(data.description, model, results)))
    if arguments.out is not None and results:
        write_page(arguments.out, validation_page(data.description, model, results))
        print(f"report: {arguments.out}", file=sys.stderr)
    beyond = [f"session {each.session.name}: {problem}" for each in results for problem in each.beyond]
    for message in beyond:
        print(f"softsim validate: beyond its limit: {message}", file=sys.stderr)
    if interrupted:
        return EXIT_INTERRUPTED
    return 1 if beyond or failed else 0


def _results(
    arguments: argparse.Namespace, data: DataSet, model: str | None, limits: dict[str, float]
) -> tuple[list[SessionResult], bool, bool]:
    """Return the result of each session, whether one had none, and whether the run was interrupted."""
    from softsim_core.lab.identification import (
        given_alignment,
        load_session,
        read_alignments,
        session_robot,
        validate_session,
    )

    alignments = read_alignments(arguments.alignment) if arguments.alignment is not None else None
    all_names, names = data.description.session_names, arguments.session
    for name in names:
        if name not in all_names:
            hint = known_names(name, all_names, "there are")
            raise DataError(data.description.name, "", f"no session {name!r}; {hint}")
    chosen = [
        replace(each, limits=replace(each.limits, **limits))
        for each in data.description.sessions
        if not names or each.name in names
    ]
    sessions = [load_session(data, each, arguments.every) for each in chosen]  # all, before a replay
    results: list[SessionResult] = []
    failed = interrupted = False
    for session in sessions:
        asked = model is not None and session.description.replayed
        robot = session_robot(model, session.description) if model is not None and asked else None
        alignment = given_alignment(alignments, session) if alignments is not None and asked else None
        progress = _Progress(session)
        try:
            results.append(validate_session(session, robot, arguments.order, progress, alignment))
        except DataError as error:
            print(f"softsim validate: {error}", file=sys.stderr)
            failed = True
        except KeyboardInterrupt:
            interrupted = True
        finally:
            progress.end()
        interrupted = interrupted or any(each.stopped for each in results)
        if interrupted:
            print("softsim validate: interrupted; what is done follows", file=sys.stderr)
            break
    return results, failed, interrupted


class _Progress:
    """A line on the terminal: progress, rate, remaining time; at the end, the rate."""

    def __init__(self, session: Session) -> None:
        self._name, self._what = session.name, "rows" if session.times is None else "steps"
        self._line, self._begin, self._done = ProgressLine(sys.stderr), time.monotonic(), 0

    def __call__(self, done: int, total: int) -> None:
        self._done = done
        rate = done / max(time.monotonic() - self._begin, 1e-9)
        line = f"{self._name}: {done}/{total} {self._what}, {rate:.1f} per second"
        self._line.show(f"{line}, {(total - done) / rate:.0f} s to go", at_once=done == total)

    def end(self) -> None:
        if self._done:
            spent = time.monotonic() - self._begin
            rate = f"{self._done / spent:.1f} per second"
            self._line.end(f"{self._name}: {self._done} {self._what} in {spent:.1f} s, {rate}")
