"""`softsim bench --batch`: measure copies that are stepped together, and the environments that use them."""

from __future__ import annotations

import argparse
import sys

from softsim_ros.benchmark import (
    COUNTS,
    QUICK_COUNTS,
    WORKERS,
    BatchRate,
    EnvironmentCost,
    cost_table,
    default_reference_dir,
    describe_machine,
    describe_missed_targets,
    known_paths,
    measure_copies,
    measure_environments,
    measure_peer,
    peer_missing,
    rate_table,
    write_json,
)

MOST_ROUNDS = 5
PEER_COUNT = 8
"""Largest number of copies for MuJoCo, whose steps take up to 40 ms each."""


def run_batch(arguments: argparse.Namespace, rounds: int) -> int:
    """Measure and print; return 1 if a target is missed and `--check` is given."""
    if "numba" not in known_paths():
        print("softsim bench: --batch needs the package numba: pip install numba", file=sys.stderr)
        return 2
    print("\n".join(describe_machine()))
    counts = QUICK_COUNTS if arguments.quick else COUNTS
    rounds, reference = min(rounds, MOST_ROUNDS), arguments.reference or default_reference_dir()
    rates: list[BatchRate] = []
    for each in measure_copies(counts, WORKERS, rounds, reference):
        _say(f"{each.scene} {each.mesh}, {each.copies} copies on {each.workers}: {each.rate:.0f} steps/s")
        rates.append(each)
    notes: list[str] = []
    if arguments.peers and (absent := peer_missing()):
        notes.append(absent)
    elif arguments.peers:
        rates += measure_peer([count for count in counts if count <= PEER_COUNT], WORKERS, rounds, reference)
    print("\nsteps of all copies per second of wall time; single: one Simulation in the same turns")
    print("\n".join([*rate_table(rates), *notes]))
    costs: list[EnvironmentCost] = []
    try:
        costs = measure_environments(max(counts[-2], 8), rounds)
        print("\nactions of all robots per second; overhead: share of the time outside the physics")
        print("\n".join(cost_table(costs)))
    except ImportError as error:
        print(f"environments are not measured: {error}")
    slow = describe_missed_targets(rates) + [each.report_line for each in costs if each.missed]
    print("\n".join(slow) if slow else "all targets met")
    try:
        if arguments.json:
            write_json([*rates, *costs], arguments.json)
    except OSError as error:
        _say(f"softsim bench: cannot write {arguments.json}: {error.strerror}")
        return 1
    return 1 if arguments.check and slow else 0


def _say(message: str) -> None:
    print(message, file=sys.stderr, flush=True)
