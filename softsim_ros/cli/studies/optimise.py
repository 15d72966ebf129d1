"""`softsim optimise STUDY`: find the values of a study's variables at which its objective is best."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from softsim_ros.cli.studies.sweep import Progress, check_numbers, configure_running, options, print_summary


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("study", help="a study with an objective: a file, or the name of a known one")
    configure_running(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run generations until the optimum is found, and print it."""
    from softsim_core.lab.study import optimise, prepare_study

    check_numbers(arguments)
    prepared = prepare_study(arguments.study, arguments.allow_code)
    store = arguments.out or Path(f"{prepared.study.name}.zarr")
    progress = Progress()
    try:
        found = optimise(prepared, store, options(arguments, store, progress))
    finally:
        progress.end()
    if arguments.json:
        result = {
            "store": str(store),
            "run": found.run,
            "objective": found.objective,
            "values": dict(found.values),
            "generations": found.generations,
            "ended": found.ended,
            "new": found.summary.new,
            "counts": dict(found.summary.counts),
        }
        print(json.dumps(result))
        return 0
    print_summary(found.summary, as_json=False)
    units = {each.name: each.unit for each in prepared.study.variables}
    print(f"{found.generations} generations; {found.ended}")
    print(f"best is run {found.run}, objective {found.objective:.6g}:")
    for name, value in found.values.items():
        print(f"  {name} = {value:.6g} {units[name]}".rstrip())
    return 0
