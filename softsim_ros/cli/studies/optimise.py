"""`softsim optimise STUDY`: find the values of a study's variables at which its objective is best."""

from __future__ import annotations

import argparse
import json

from softsim_ros.cli.studies.sweep import configure_running, print_summary, run_study


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("study", help="a study with an objective: a file, or the name of a known one")
    configure_running(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run generations until the optimum is found, and print it."""
    from softsim_core.lab.study import optimise

    study, found = run_study(arguments, optimise)
    if arguments.json:
        result = {
            "store": str(found.summary.folder),
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
    units = {each.name: each.unit for each in study.variables}
    print(f"{found.generations} generations; {found.ended}")
    print(f"best is run {found.run}, objective {found.objective:.6g}:")
    for name, value in found.values.items():
        print(f"  {name} = {value:.6g} {units[name]}".rstrip())
    return 0
