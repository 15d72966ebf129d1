"""`softsim league`: all models of the measured robots on the same rows, in one table."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from softsim_core.base import DataError, SoftSimError
from softsim_ros.cli import EXIT_INTERRUPTED, CommandError, ProgressLine, UsageError, add_number, table_lines

if TYPE_CHECKING:
    from softsim_core.lab.identification import DataSet, LeagueEntry, Measures

ERRORS = ("mean", "rms", "p95")
HEAD = ("data set", "model", "numbers", "rows", *ERRORS, "held out", *ERRORS, "% length", "ms/row")


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("data_sets", nargs="*", metavar="DATASET", help="data sets (all that are known)")
    add_number(parser, "--every", 1, "N", "only each N-th static row, for a first look (1)")
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--markdown", action="store_true", help="print the table as Markdown")
    form.add_argument("--json", action="store_true", help="print the table as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Compare the data sets that are present, name the others."""
    from softsim_core.lab.identification import known_data_sets, league_entries, load_data_set

    if arguments.every < 1:
        raise UsageError("--every must be 1 or more")
    sets = [load_data_set(name) for name in arguments.data_sets or known_data_sets()]
    entries: list[LeagueEntry] = []
    present: list[DataSet] = []
    failed = interrupted = False
    line = ProgressLine(sys.stderr, log_period_s=30.0)

    def show(what: str, done: int, total: int) -> None:
        line.show(f"{what}: {done}/{total}")

    for data in sets:
        name = data.description.name
        try:
            for session in data.description.sessions:
                data.tables_of(session)
        except DataError as error:
            print(f"softsim league: {name} is left out: {error}", file=sys.stderr)
            continue
        try:
            entries += league_entries(data, arguments.every, show)
            present.append(data)
        except SoftSimError as error:
            failed = True
            print(f"softsim league: {name} failed: {error}", file=sys.stderr)
        except KeyboardInterrupt:
            interrupted = True
            print("softsim league: interrupted; the data sets that are done follow", file=sys.stderr)
            break
        finally:
            line.end()
    if not (entries or failed or interrupted):
        raise CommandError("no data set is present; each message above says where its tables come from")
    if arguments.json:
        unknown = {each.description.name: each.description.unknown for each in present}
        print(json.dumps({"entries": [each.plain() for each in entries], "unknown": unknown}))
    elif entries:
        print("\n".join(report_lines(entries, present, arguments.markdown)))
    return EXIT_INTERRUPTED if interrupted else int(failed)


def report_lines(entries: Sequence[LeagueEntry], present: Sequence[DataSet], markdown: bool) -> list[str]:
    """Return the table, errors in mm, then notes and what stays unknown."""
    rows = [HEAD, *map(_cells, entries)]
    if markdown:
        lines = [f"| {' | '.join(row)} |" for row in rows]
        lines.insert(1, "|" + "---|" * len(HEAD))
    else:
        lines = table_lines(rows, ">")
    notes = [f"{each.data_set}, {each.model}: {each.note}" for each in entries if each.note]
    notes += [f"{each.description.name}, unknown: {each.description.unknown}" for each in present
              if each.description.unknown]  # fmt: skip
    lead = "- " if markdown else ""
    return [*lines, "", *(lead + note for note in notes)]


def _cells(entry: LeagueEntry) -> tuple[str, ...]:
    numbers = "" if entry.numbers is None else str(entry.numbers)
    percent = "" if entry.percent is None else f"{entry.percent:.1f}"
    spent = "" if entry.milliseconds is None else f"{entry.milliseconds:.1f}"
    model = f"{entry.model} ({entry.kind})" if entry.kind == "published" else entry.model
    return (
        entry.data_set, model, numbers, *_errors(entry.training), *_errors(entry.held_out), percent, spent,
    )  # fmt: skip


def _errors(found: Measures) -> tuple[str, ...]:
    values = (1e3 * found.mean, 1e3 * found.rms, 1e3 * found.p95)
    return (str(found.count or ""), *("" if math.isnan(value) else f"{value:.2f}" for value in values))
