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
from softsim_node import takes_escapes
from softsim_ros import write_page
from softsim_ros.cli import UsageError

if TYPE_CHECKING:
    from softsim_core.lab.identification import DataSet, Session, SessionDescription, SessionResult

EXIT_INTERRUPTED = 130
LIMITS = ("mean", "rms", "p95", "max")


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "data_set", nargs="?", help="a data set: a name, or a folder with dataset.yaml; none lists the known"
    )
    parser.add_argument("--robot", metavar="MODEL", help="robot or scene: a name or a file (the data set's)")
    parser.add_argument("--data", type=Path, metavar="DIR", help="folder of the measured files")
    parser.add_argument(
        "--session", action="append", default=[], metavar="NAME", help="only this session; may be given again"
    )
    parser.add_argument(
        "--every", type=int, default=1, metavar="N", help="only each N-th row, for a first look (1)"
    )
    parser.add_argument(
        "--order", choices=("nearest", "rows"), default="nearest", help="of static rows (nearest)"
    )
    parser.add_argument(
        "--alignment",
        type=Path,
        metavar="JSON",
        help="frames and sensor points of an earlier report, fit none",
    )
    parser.add_argument("--others-only", action="store_true", help="run no model, compare the other models'")
    for name in LIMITS:
        parser.add_argument(
            f"--max-{name}",
            type=float,
            metavar="MM",
            help=f"largest {name} error of a session that passes, in mm",
        )
    parser.add_argument("-o", "--out", type=Path, metavar="HTML", help="write a report as a web page")
    parser.add_argument("--json", action="store_true", help="print the report as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Read, replay, align, compare."""
    from softsim_core.lab.identification import known_data_sets, load_data_set, plain
    from softsim_ros.cli.measurements.validate_report import report_lines, validation_page

    if arguments.data_set is None:
        data_sets = known_data_sets()
        width = max(map(len, data_sets), default=0)
        for name, file in data_sets.items():
            print(f"{name:<{width}}  {load_data_set(file).description.about}")
        return 0
    if arguments.every < 1 or any(not _limit(arguments, name, 1.0) > 0.0 for name in LIMITS):
        raise UsageError("--every must be 1 or more, limits must be > 0 mm")
    if importlib.util.find_spec("rosbags") is not None:
        from softsim_ros.recording import register

        register()
    data = load_data_set(arguments.data_set, arguments.data)
    model = None if arguments.others_only else arguments.robot or data.robot
    results, failed, interrupted = _results(arguments, data, model)
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


def _limit(arguments: argparse.Namespace, name: str, otherwise: float) -> float:
    value = getattr(arguments, f"max_{name}")
    return otherwise if value is None else float(value)


def _results(
    arguments: argparse.Namespace, data: DataSet, model: str | None
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
    chosen = [_with_limits(each, arguments) for each in _choose_sessions(data, arguments.session)]
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


def _choose_sessions(data: DataSet, names: list[str]) -> list[SessionDescription]:
    session_names = data.description.session_names
    for name in names:
        if name not in session_names:
            raise DataError(
                data.description.name,
                "",
                f"no session {name!r}; {known_names(name, session_names, 'there are')}",
            )
    return [each for each in data.description.sessions if not names or each.name in names]


def _with_limits(session: SessionDescription, arguments: argparse.Namespace) -> SessionDescription:
    """Return the session with the limits of the command line in place of its own."""
    options = {
        f"{name}_mm": value for name in LIMITS if (value := getattr(arguments, f"max_{name}")) is not None
    }
    return replace(session, limits=replace(session.limits, **options)) if options else session


class _Progress:
    """A line on the terminal: progress, rate, remaining time; at the end, the rate."""

    def __init__(self, session: Session) -> None:
        self._name = session.name
        self._what = "rows" if session.times is None else "steps"
        self._shown, self._next = takes_escapes(sys.stderr), 0.0
        self._begin = time.monotonic()
        self._done = 0

    def __call__(self, done: int, total: int) -> None:
        now, self._done = time.monotonic(), done
        if self._shown and (now >= self._next or done == total):
            self._next = now + 0.2
            rate = done / max(now - self._begin, 1e-9)
            left = (total - done) / rate
            line = f"{self._name}: {done}/{total} {self._what}, {rate:.1f} per second, {left:.0f} s to go"
            print(f"\r{line:<78}", end="", file=sys.stderr, flush=True)

    def end(self) -> None:
        if not self._done:
            return
        spent = time.monotonic() - self._begin
        text = (
            f"{self._name}: {self._done} {self._what} in {spent:.1f} s, {self._done / spent:.1f} per second"
        )
        print(f"\r{text:<78}" if self._shown else text, file=sys.stderr)
