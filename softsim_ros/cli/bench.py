"""`softsim bench`: time of a simulation step on this machine, one thread, with what it is compared to."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from softsim_ros.benchmark.machine import describe_machine, limit_threads  # loads no NumPy

if TYPE_CHECKING:
    from softsim_ros.benchmark.records import Record

ROUNDS, QUICK_ROUNDS = 40, 5
QUICK_MESHES = ("low", "reference_low")


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("--quick", action="store_true", help="low meshes only, few samples, no node")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers as a list of objects")
    parser.add_argument(
        "--scene", action="append", choices=("held_centre", "tripod"), help="only this scene (repeatable)"
    )
    parser.add_argument(
        "--mesh",
        action="append",
        metavar="NAME",
        help="only this mesh (repeatable): low, mid, high, reference_low, reference_mid, reference_high",
    )
    parser.add_argument(
        "--reference",
        type=Path,
        metavar="DIR",
        help="folder with the reference data; default: $SOFTSIM_REFERENCE, else ../shared/reference",
    )
    parser.add_argument("--rounds", type=int, metavar="N", help=f"turns of each thing measured ({ROUNDS})")
    parser.add_argument(
        "--peers", action="store_true", help="add Drake's deformable body and MuJoCo's flex, where installed"
    )
    parser.add_argument(
        "--no-process", action="store_true", help="leave out memory and publishing of the simulator process"
    )
    parser.add_argument("--check", action="store_true", help="exit with 1 when a target is missed")


def run(arguments: argparse.Namespace) -> int:
    """Measure, print, write."""
    alone = limit_threads(os.environ)
    if arguments.rounds is not None and arguments.rounds < 1:
        print("softsim bench: --rounds must be at least 1", file=sys.stderr)
        return 2
    from softsim_ros.benchmark.cases import MESHES, SCENES, available_meshes, default_reference_dir

    reference = arguments.reference or default_reference_dir()
    there = available_meshes(reference)
    meshes = arguments.mesh or [mesh for mesh in there if not arguments.quick or mesh in QUICK_MESHES]
    for mesh in meshes:
        if mesh not in there:
            why = f"not found in {reference}" if mesh in MESHES else f"unknown; known: {', '.join(MESHES)}"
            print(f"softsim bench: mesh {mesh}: {why}", file=sys.stderr)
            return 2
    if not any(mesh.startswith("reference_") for mesh in there):
        _say(f"no reference meshes in {reference} (--reference DIR, or SOFTSIM_REFERENCE): ours only")

    print("\n".join(describe_machine()))
    print("one thread" + ("" if alone else " wanted, but NumPy was already loaded with its own setting"))
    records = _measure(
        meshes, arguments.scene or list(SCENES), reference, arguments.rounds, quick=arguments.quick
    )
    missed = _report(records)
    if arguments.json:
        from softsim_ros.benchmark.records import write_json

        try:
            write_json(records, arguments.json)
        except OSError as error:
            print(f"softsim bench: cannot write {arguments.json}: {error.strerror}", file=sys.stderr)
            return 1
    return 1 if arguments.check and missed else 0


def _measure(
    meshes: list[str], scenes: list[str], reference: Path, rounds: int | None, *, quick: bool
) -> list[Record]:
    from softsim_ros.benchmark.cases import cases
    from softsim_ros.benchmark.records import judge
    from softsim_ros.benchmark.steps import known_paths, measure

    paths = known_paths()
    if "numba" not in paths:
        _say("numba is not installed: only the SciPy path is measured; pip install numba")
    records = []
    for group in cases(meshes, scenes, reference):
        _say(f"measuring {' and '.join(case.scene for case in group)} on {group[0].mesh} ...")
        records += measure(group, paths, rounds or (QUICK_ROUNDS if quick else ROUNDS))
    judge(records)
    return records


def _report(records: list[Record]) -> int:
    """Print the table; the number of missed targets."""
    from softsim_ros.benchmark.report import table

    print("\ntime to advance by one dt, whole Simulation.step(); splu: one factorisation of the same matrix")
    print("\n".join(table(records)))
    missed = sum(record.missed for record in records)
    judged = sum(record.ratio is not None for record in records)
    print(f"{judged - missed} of {judged} targets met" if judged else "nothing to judge")
    return missed


def _say(sentence: str) -> None:
    print(sentence, file=sys.stderr, flush=True)
