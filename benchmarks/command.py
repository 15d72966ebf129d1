"""`softsim bench`: measure a simulation step on this machine with one thread, and compare it."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from softsim_core.base import describe_machine, limit_threads  # loads no NumPy

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from benchmarks.copies import BatchRate, EnvironmentCost
    from benchmarks.measured_scenes import Case
    from benchmarks.records import JsonRecord, Record

ROUNDS, QUICK_ROUNDS = 40, 5
QUICK_MESHES = ("low", "reference_low")
PEER_MESHES = ("low", "mid")
MOST_BATCH_ROUNDS = 5
MOST_PEER_COPIES = 8
"""Largest number of copies for MuJoCo, whose steps take up to 40 ms each."""

EXIT_USAGE = 2
SCENES = (
    "held_centre", "tripod", "inverse", "cable_finger", "gripper_free", "gripper_grasp", "tripod_ball",
)  # fmt: skip  # named here too: to take them from benchmark.cases would load NumPy


class Measurement(NamedTuple):
    """What an option measures instead of whole steps.

    Attributes:
        run: Measures and prints; returns the exit code.
        about: What is measured, for the help.
        needs_numba: Whether it is refused without Numba.
        describes_machine: Whether the machine is printed first.
    """

    run: Callable[[argparse.Namespace], int]
    about: str
    needs_numba: bool = False
    describes_machine: bool = True


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("--quick", action="store_true", help="low meshes only, few samples, no node process")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers as a list of objects")
    parser.add_argument(
        "--scene",
        action="append",
        choices=SCENES,
        help="only this scene (repeatable)",
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
    for name, measurement in MEASUREMENTS.items():
        parser.add_argument(f"--{name}", action="store_true", help=f"measure only {measurement.about}")
    parser.add_argument(
        "--seconds", type=float, default=20.0, metavar="S", help="how long --bridge measures each way (20)"
    )
    parser.add_argument("--check", action="store_true", help="exit with 1 when a target is missed")


def run(arguments: argparse.Namespace) -> int:
    """Measure, print, write."""
    alone = limit_threads(os.environ)
    if arguments.rounds is not None and arguments.rounds < 1:
        return _refuse("--rounds must be at least 1")
    if not arguments.seconds >= 1.0:
        return _refuse("--seconds must be at least 1")
    for name, measurement in MEASUREMENTS.items():
        if getattr(arguments, name):
            return _measure_only(name, measurement, arguments)
    from benchmarks.measured_scenes import MESHES, available_meshes, default_reference_dir
    from softsim_core.base import known_names

    reference = arguments.reference or default_reference_dir()
    there = available_meshes(reference)
    meshes = arguments.mesh or [mesh for mesh in there if not arguments.quick or mesh in QUICK_MESHES]
    for mesh in meshes:
        if mesh not in MESHES:
            return _refuse(f"unknown mesh {mesh}; {known_names(mesh, MESHES, 'known meshes:')}")
        if mesh not in there:
            return _refuse(
                f"mesh {mesh} needs the reference data, which are not in {reference}; use --reference DIR"
            )
    if there == [mesh for mesh in MESHES if not mesh.startswith("reference_")]:
        _say(f"no reference meshes in {reference} (--reference DIR, or SOFTSIM_REFERENCE): ours only")

    print("\n".join(describe_machine()))
    print("one thread" + ("" if alone else " wanted, but NumPy was already loaded with its own setting"))
    records, missed = _steps(arguments, meshes, reference)
    if arguments.peers:
        records += _peers(arguments, meshes, records, reference)
    if not (arguments.quick or arguments.no_process):
        missed += _process(records)
    return _write_results(records, arguments, missed > 0)


def _measure_only(name: str, measurement: Measurement, arguments: argparse.Namespace) -> int:
    """Run one measurement of the table; return the exit code."""
    if measurement.needs_numba:
        from benchmarks.steps import known_paths

        if "numba" not in known_paths():
            return _refuse(f"--{name} needs the package numba: pip install numba")
    if measurement.describes_machine:
        print("\n".join(describe_machine()))
    return measurement.run(arguments)


def _install(arguments: argparse.Namespace) -> int:
    """Measure and print a first start."""
    from benchmarks.first_start import INSTALL_WITHIN_S, FirstStart, compare_with_targets

    checkout = Path(__file__).resolve().parents[1]
    if not (checkout / "softsim").is_file():
        return _refuse(f"--install copies a checkout, and {checkout} is none")
    cores, load = os.cpu_count(), os.getloadavg()[0]
    print(f"first start of a copy of {checkout}: {cores} cores, load {load:.1f}", flush=True)
    first = FirstStart(checkout, "tripod", lambda line: print(line, flush=True))
    if code := first.run(INSTALL_WITHIN_S):
        print("\n".join(first.output[-15:]), file=sys.stderr)
        print(f"softsim bench: the first start failed (exit code {code})", file=sys.stderr)
        return 1
    lines, missed = compare_with_targets(first.phases, first.factors)
    print("\n".join(lines))
    return 1 if arguments.check and missed else 0


def _rounds(arguments: argparse.Namespace) -> int:
    return int(arguments.rounds or (QUICK_ROUNDS if arguments.quick else ROUNDS))


def _steps(arguments: argparse.Namespace, meshes: list[str], reference: Path) -> tuple[list[Record], int]:
    """Measure and print whole steps; return the records and the number of missed targets."""
    from benchmarks.measured_scenes import cases
    from benchmarks.records import set_ratios, table
    from benchmarks.steps import known_paths, measure

    paths = known_paths()
    if "numba" not in paths:
        _say("numba is not installed: only the SciPy path is measured; pip install numba")
    records = []
    for group in cases(meshes, arguments.scene or SCENES, reference):
        _say(f"measuring {' and '.join(case.scene for case in group)} on {group[0].mesh} ...")
        records += measure(group, paths, _rounds(arguments))
    set_ratios(records)
    print("\nwhole Simulation.step(), one dt; splu: one factorisation of the same step's matrix, same run;")
    print(
        "reference: nodes and tets of the scene on the reference's mesh; of scipy: share of the SciPy path;"
    )
    print("probe: a fixed kernel that streams and multiplies, so that a missed target is not the machine's")
    print("\n".join(table(records)))
    missed = sum(record.missed for record in records)
    compared = sum(record.ratio is not None for record in records)
    print(f"{compared - missed} of {compared} targets met" if compared else "nothing to judge")
    return records, missed


def _peers(
    arguments: argparse.Namespace, meshes: list[str], ours: list[Record], reference: Path
) -> list[Record]:
    """Measure the clamped body in other engines and print it; return the records."""
    from benchmarks.measured_scenes import Case, describe

    chosen = meshes if arguments.mesh else [mesh for mesh in meshes if mesh in PEER_MESHES]
    cases = [Case("held_centre", mesh, describe("held_centre", mesh, reference)) for mesh in chosen]
    records = _compare_engines(cases, _rounds(arguments))
    for found in records:
        for record in ours:  # also store the sag of the same run with our own time
            if (record.scene, record.mesh, record.path) == ("held_centre", found.mesh, "numba"):
                record.extras["sag_mm"] = found.extras["ours_sag_mm"]
    return records


def _compare_engines(cases: Sequence[Case], rounds: int, to_rest: bool = True) -> list[Record]:
    """Measure clamped bodies in other engines and print them; return the records."""
    from benchmarks.peers import compare
    from benchmarks.records import peer_table

    records: list[Record] = []
    notes: dict[str, None] = {}
    for case in cases:
        _say(f"measuring the held body in other engines on {case.mesh} ...")
        found, missing = compare(case, rounds, to_rest)
        records += found
        notes |= dict.fromkeys(missing)
    print("\nthe held body in other engines, one dt of the scene; sag: of the lowest node, at rest")
    print("\n".join([*(peer_table(records) if records else ()), *notes]))
    return records


def _process(records: list[Record]) -> int:
    """Measure a simulator process and print it; return the number of missed targets."""
    from benchmarks.process import MEMORY_LIMIT_MB, PUBLISH_LIMIT_MS, measure_process

    _say("running the simulator on mid for 1000 steps ...")
    figures = measure_process()
    verdict = "MISSED" if figures.memory_mb > MEMORY_LIMIT_MB else "ok"
    print(f"\n{figures.what}, mid, after {figures.steps} steps:")
    print(f"  memory {figures.memory_mb:.0f} MB, target <= {MEMORY_LIMIT_MB:.0f} MB: {verdict}")
    missed = int(figures.memory_mb > MEMORY_LIMIT_MB)
    extras: dict[str, object] = {"memory_mb": figures.memory_mb}
    if figures.publish_ms is not None:
        late = figures.publish_ms > PUBLISH_LIMIT_MS
        missed += late
        print(
            f"  publishing {figures.publish_ms:.2f} ms per step, target <= {PUBLISH_LIMIT_MS:.0f} ms: "
            f"{'MISSED' if late else 'ok'}; real-time factor {figures.real_time_factor:.2f}"
        )
        extras |= {"publish_ms": figures.publish_ms}
    for record in records:
        if (record.scene, record.mesh, record.path) == ("tripod", "mid", "numba"):
            record.extras.update(extras)
    return missed


def _bridge(arguments: argparse.Namespace) -> int:
    """Measure the servo bridge and print it; return 1 if a target is missed and `--check` is given."""
    from benchmarks.bridge import measure_bridge

    _say(f"running the bridge twice for {arguments.seconds:g} s ...")
    figures = measure_bridge(seconds=arguments.seconds)
    for each in figures:
        print("\n".join(each.lines()))
    return 1 if arguments.check and any(each.late for each in figures) else 0


def _scaling(arguments: argparse.Namespace) -> int:
    """Measure meshes of growing size and print them; return 1 if one could not be measured."""
    from benchmarks.scaling import QUICK_SIZES, SIZES, ScalingError, measure_scaling, scaling_table

    scales, sizes = [], QUICK_SIZES if arguments.quick else SIZES
    try:
        for each in measure_scaling(sizes):
            _say(f"measured {each.shape} {each.size}: {each.step_ms:.1f} ms a step")
            scales.append(each)
    except ScalingError as error:
        _say(f"softsim bench: {error}")
        return 1
    print(
        "whole steps of a held body that falls, processor time of one thread, shortest; plan: symbolic only"
    )
    print("\n".join(scaling_table(scales)))
    peers = _scaling_peers(sizes) if arguments.peers else []
    return _write_results([*scales, *peers], arguments, missed=False)


def _scaling_peers(sizes: Sequence[str]) -> list[Record]:
    """Measure the same bodies in other engines if these step in less than seconds; return the records."""
    from benchmarks.measured_scenes import Case
    from benchmarks.scaling import PEER_ROUNDS, PEER_SIZES, SHAPES, clamped_scene, mesh_of
    from softsim_core.scene import RobotDescription

    bodies = [(shape, size) for shape in SHAPES for size in sizes if size in PEER_SIZES]
    cases = [
        Case("scaling", f"{shape} {size}", RobotDescription(scene=clamped_scene(mesh_of(shape, size))))
        for shape, size in bodies
    ]
    return _compare_engines(cases, PEER_ROUNDS, to_rest=False)


def _rubber(arguments: argparse.Namespace) -> int:
    """Measure quadratic cells and chambers and print them; return 1 if a target is missed with `--check`."""
    from benchmarks.rubber import measure_rubber, rubber_table

    times = measure_rubber(_rounds(arguments))
    print("\nwhole Simulation.step() in turns with one factorisation of its matrix, or with the same scene")
    print("without its chambers; what is judged is the shortest time, or what that is longer by")
    print("\n".join(rubber_table(times)))
    return _write_results(times, arguments, any(each.missed for each in times))


def _rods(arguments: argparse.Namespace) -> int:
    """Measure a falling rod, beside PyElastica where it is installed; return 1 if a target is missed."""
    from benchmarks import rods

    absent = rods.peer_missing()
    falls, notes = rods.measure_rods(absent is None)
    print(f"\na rod that falls for {rods.SECONDS} s; error of its free end, simulated seconds per second")
    print("\n".join([*rods.rod_table(falls), *notes]))
    if absent is not None:
        print(absent)
        return _write_results(falls, arguments, missed=False)
    ratios = {n: rods.speed_ratio(falls, n) for n in rods.COUNTS}
    for n, ratio in ratios.items():
        print(
            f"error of at most {rods.EQUAL:g} mm with {n} elements: {ratio:.1f} times as fast as {rods.PEER} "
            f"with {rods.COUNTS[0]}"
        )
    return _write_results(falls, arguments, max(ratios.values()) < rods.LIMIT)


def _cosserat(arguments: argparse.Namespace) -> int:
    """Run the experiments of cosseratbench; return 1 if ours is not the first in enough of them."""
    from softsim_core.base import install_command, version_of

    if not version_of("cosseratbench"):
        return _refuse(f"--cosserat needs the package cosseratbench: {install_command('peers')}")
    from benchmarks import cosserat

    scores: list[cosserat.Score] = []
    notes: dict[str, None] = {}
    for name in cosserat.QUICK_EXPERIMENTS if arguments.quick else cosserat.MEASURES:
        found, missing = cosserat.measure_experiment(name, cosserat.peers(), _say)
        scores += found
        notes |= dict.fromkeys(missing)
    print("\nexperiments of cosseratbench; 0 is exact; of ours the second run, its kernels are compiled then")
    print("\n".join([*cosserat.score_table(scores), *notes]))
    places = [each.place for each in scores if each.result.solver == cosserat.OURS]
    print(f"first in {places.count(1)}, second in {places.count(2)} of {len(places)} experiments")
    return _write_results(scores, arguments, len(places) - places.count(1) > cosserat.NOT_FIRST)


def _sensors(arguments: argparse.Namespace) -> int:
    """Measure sensors and print them; return 1 if a target is missed and `--check` is given."""
    from benchmarks.sensing import SCENE, measure_sensors, sensor_table

    times = measure_sensors(_rounds(arguments))
    print(f"\nstage `sensors` of a step of {SCENE}, each sensor alone, then all, read once per step")
    print("\n".join(sensor_table(times)))
    return _write_results(times, arguments, any(each.missed for each in times))


def _write_results(results: Sequence[JsonRecord], arguments: argparse.Namespace, missed: bool) -> int:
    """Write the file of `--json`; return 1 if that fails, or if a target is missed and `--check` is given."""
    from benchmarks.records import write_json

    try:
        if arguments.json:
            write_json(results, arguments.json)
    except OSError as error:
        _say(f"softsim bench: cannot write {arguments.json}: {error.strerror}")
        return 1
    return 1 if arguments.check and missed else 0


def _batch(arguments: argparse.Namespace) -> int:
    """Measure copies and print them; return 1 if a target is missed and `--check` is given."""
    from benchmarks.copies import (
        COUNTS,
        QUICK_COUNTS,
        WORKERS,
        cost_table,
        describe_missed_targets,
        measure_copies,
        measure_environments,
        measure_peer,
        peer_missing,
        rate_table,
    )
    from benchmarks.measured_scenes import default_reference_dir

    counts = QUICK_COUNTS if arguments.quick else COUNTS
    rounds = min(_rounds(arguments), MOST_BATCH_ROUNDS)
    reference = arguments.reference or default_reference_dir()
    rates: list[BatchRate] = []
    for each in measure_copies(counts, WORKERS, rounds, reference):
        _say(f"{each.scene} {each.mesh}, {each.copies} copies on {each.workers}: {each.rate:.0f} steps/s")
        rates.append(each)
    notes: list[str] = []
    if arguments.peers and (absent := peer_missing()):
        notes.append(absent)
    elif arguments.peers:
        rates += measure_peer(
            [count for count in counts if count <= MOST_PEER_COPIES], WORKERS, rounds, reference
        )
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
    return _write_results([*rates, *costs], arguments, bool(slow))


def _viewer(arguments: argparse.Namespace) -> int:
    """Measure the web viewer and print it; return 1 if a target is missed and `--check` is given."""
    from benchmarks.viewer import measure_viewer

    _say("running the simulator alone and watched in turn, about a minute ...")
    figures = measure_viewer()
    print("\n".join(figures.lines()))
    return 1 if arguments.check and figures.missed else 0


def _say(message: str) -> None:
    print(message, file=sys.stderr, flush=True)


def _refuse(message: str) -> int:
    _say(f"softsim bench: {message}")
    return EXIT_USAGE


MEASUREMENTS: Final = {
    "bridge": Measurement(_bridge, "the servo bridge on a virtual board: topic to last byte, send period"),
    "scaling": Measurement(
        _scaling,
        "how a step grows with its mesh, 1 k to 50 k nodes (minutes; --quick: to 3 k); "
        "with --peers beside other engines, to 3 k",
        needs_numba=True,
    ),
    "rubber": Measurement(
        _rubber, "quadratic cells beside splu, and what chambers cost (two minutes)", needs_numba=True
    ),
    "rods": Measurement(
        _rods,
        "a falling rod: error over cost, beside PyElastica where installed (a minute)",
        needs_numba=True,
    ),
    "cosserat": Measurement(
        _cosserat,
        "the experiments of cosseratbench, beside its solvers where installed (many minutes; --quick: three)",
        needs_numba=True,
    ),
    "sensors": Measurement(_sensors, "what each kind of sensor costs per step (10 s)", needs_numba=True),
    "batch": Measurement(
        _batch,
        "copies stepped together, on one and two cores (minutes; --quick: half a minute); "
        "with --peers beside MuJoCo's batched steps of a flex",
        needs_numba=True,
    ),
    "install": Measurement(
        _install,
        "the first start: a copy of the checkout, empty environment and caches (minutes)",
        describes_machine=False,
    ),
    "viewer": Measurement(_viewer, "the web viewer: its load, and the step time with it"),
}
"""Measurements by the names of their options; the first that is given runs."""
