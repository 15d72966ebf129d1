"""Measure how a step grows with its mesh: time, memory and size of the factor, each mesh in its own process.

A step with one thread is measured by the processor time of that thread, since steps of several seconds never
run undisturbed. With all threads it is measured by the clock, in turns with steps of one thread.
"""

from __future__ import annotations

import json
import math
import resource
import sys
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from time import perf_counter, process_time

import numpy as np

from benchmarks.process import run_measurement
from benchmarks.records import align_columns
from benchmarks.steps import step_matrix
from softsim_core import (
    AttachmentDescription,
    BodyDescription,
    Box,
    MaterialDescription,
    SceneDescription,
    Simulation,
    SolverSettings,
    TetMesh,
    box_mesh,
)
from softsim_core.physics.linalg import factorise_matrix
from softsim_core.physics.mechanics import Model
from softsim_core.robots import tripod_mesh

SIZES = ("1k", "3k", "10k", "30k", "50k")
QUICK_SIZES = ("1k", "3k")
SHAPES = ("box", "silicone")
BOX_CELLS = {"1k": 9, "3k": 13, "10k": 21, "30k": 30, "50k": 36}
"""Cells along each edge of a cube of 0.1 m."""

SILICONE_LEVELS = {"1k": (3, 2), "3k": (5, 4), "10k": (8, 6), "30k": (12, 9), "50k": (14, 11)}
"""Divisions and layers of the Tripod's silicone, see robots.tripod_mesh."""

SILICONE = MaterialDescription(young_modulus=250e3, poisson_ratio=0.45)

PEER_SIZES = QUICK_SIZES
"""Sizes for other engines; larger bodies take them many seconds per step."""

PEER_ROUNDS = 3

SPLU_SIZES = QUICK_SIZES
"""Sizes for SuperLU; larger matrices take it minutes."""

LEAD_IN_STEPS, MOST_STEPS, ENOUGH_S = 2, 30, 6.0
HEAD = (
    "shape", "size", "nodes", "tets", "plan s", "step ms", "solve ms", "iterations", "ms (threads)",
    "speed-up", "splu ms", "nnz(L)", "Gflop", "peak MB", "exponent",
)  # fmt: skip


class ScalingError(Exception):
    """A mesh could not be measured; the message contains the output of its process."""


@dataclass(frozen=True)
class Scale:
    """Cost of one mesh.

    Attributes:
        shape, size: From SHAPES and SIZES.
        nodes, elements: Size of the mesh.
        plan_s: Processor time in [s] of planning the elimination of its free nodes.
        step_ms: Shortest processor time of a step with one thread in [ms].
        solve_ms: Part of factorisation or iteration in that in [ms], by the median of its fractions.
        iterations: Conjugate gradient iterations, median over the steps; 0: each step factorises.
        threads: Number of threads of a step that is large enough.
        threads_ms: Shortest time of a step with them by the clock in [ms].
        speed_up: Shortest time with one thread over that with all, by the clock.
        splu_ms: Shortest processor time of SuperLU on the matrix of the step in [ms]; None: not measured.
        factor_entries: Number of entries of the factor.
        flops: Multiplications and additions of the factorisation.
        peak_mb: Largest resident memory of the process in [MB].
    """

    shape: str
    size: str
    nodes: int
    elements: int
    plan_s: float
    step_ms: float
    solve_ms: float
    iterations: int
    threads: int
    threads_ms: float
    speed_up: float
    splu_ms: float | None
    factor_entries: int
    flops: float
    peak_mb: float

    def as_json(self) -> dict[str, object]:
        """Return the measurement as a JSON object."""
        return asdict(self)


def mesh_of(shape: str, size: str) -> TetMesh:
    """Return the mesh of that shape and size."""
    if shape == "box":
        return box_mesh((0.1, 0.1, 0.1), (BOX_CELLS[size],) * 3)
    return tripod_mesh.tripod_silicone(*SILICONE_LEVELS[size])


def clamped_scene(mesh: TetMesh, threads: int = 1) -> SceneDescription:
    """Return a silicone body that is clamped near the z axis at low height and falls under gravity."""
    near = Box(center=(0.0, 0.0, 0.0), size=(0.03, 0.03, 0.03))
    hold = AttachmentDescription(name="hold", body="body", to="world", box=near)
    body = BodyDescription(name="body", mesh=mesh, material=SILICONE, total_mass=0.05)
    solver = SolverSettings(threads=threads)
    return SceneDescription(name="scaling", bodies=(body,), attachments=(hold,), solver=solver)


def build_clamped_simulation(mesh: TetMesh, threads: int = 1) -> Simulation:
    """Return a compiled simulation of `clamped_scene`."""
    with warnings.catch_warnings():  # the warnings about slivers are known
        warnings.simplefilter("ignore", UserWarning)
        return Simulation(clamped_scene(mesh, threads), backend="numba")


def measure_scale(shape: str, size: str) -> Scale:
    """Measure one mesh in this process."""
    from softsim_core.base import usable_cores
    from softsim_core.physics.linalg import alone

    threads = usable_cores()
    simulation = build_clamped_simulation(mesh_of(shape, size), threads)
    for _ in range(LEAD_IN_STEPS):
        simulation.step()
    steps: list[float] = []
    by_clock: tuple[list[float], list[float]] = ([], [])
    shares: list[float] = []
    iterations: list[int] = []
    while len(steps) < MOST_STEPS and sum(steps) < 1e3 * ENOUGH_S:
        started, clock = process_time(), perf_counter()
        with alone():
            simulation.step()
        steps.append(1e3 * (process_time() - started))
        by_clock[0].append(1e3 * (perf_counter() - clock))
        stages = simulation.stage_times
        shares.append(stages["factor" if "factor" in stages else "iterate"] / stages["step"])
        iterations.append(simulation.report.linear_iterations)
        clock = perf_counter()
        simulation.step()
        by_clock[1].append(1e3 * (perf_counter() - clock))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024.0 / 1e6  # before SuperLU runs
    plan_s, entries, flops = measure_planning(simulation.model)
    splu = [factorisation_ms(simulation) for _ in range(3)] if size in SPLU_SIZES else []
    return Scale(
        shape,
        size,
        len(simulation.positions),
        len(simulation.tets),
        plan_s,
        min(steps),
        min(steps) * float(np.median(shares)),
        int(np.median(iterations)),
        threads,
        min(by_clock[1]),
        min(by_clock[0]) / min(by_clock[1]),
        min(splu, default=None),
        entries,
        flops,
        peak,
    )


def measure_planning(model: Model) -> tuple[float, int, float]:
    """Return seconds of planning the elimination of a model's free nodes, entries and flops of the factor."""
    from softsim_core.physics.dynamics.numba_backend import node_pairs
    from softsim_core.physics.linalg import LANES, ROWS, plan

    local = np.full(len(model.rest), -1, dtype=np.int64)
    local[model.free_nodes] = np.arange(len(model.free_nodes))
    edges = local[np.concatenate([node_pairs(group.cells) for group in model.groups])]
    edges = np.unique(edges[(edges >= 0).all(axis=1)], axis=0)
    started = process_time()
    layout = plan(len(model.free_nodes), edges, np.zeros((0, 2), np.int64), 0, LANES, ROWS)
    seconds = process_time() - started
    own, coupled = layout.columns.astype(float), layout.side - 1.0
    entries = own * (own + 1.0) / 2.0 + own * coupled
    flops = own * (own + 1.0) * (2.0 * own + 1.0) / 6.0 + own * coupled * (own + coupled)
    return seconds, int(entries.sum()), float(flops.sum())


def factorisation_ms(simulation: Simulation) -> float:
    """Return the processor time in [ms] of one SuperLU factorisation of the next step's matrix."""
    matrix = step_matrix(simulation)
    started = process_time()
    factorise_matrix(matrix)
    return 1e3 * (process_time() - started)


def measure_scaling(sizes: Iterable[str], shapes: Iterable[str] = SHAPES) -> Iterator[Scale]:
    """Measure each mesh in a new process, one after another.

    Raises:
        ScalingError: a process failed.
    """
    chosen = tuple(sizes)
    for shape in shapes:
        for size in chosen:
            child = run_measurement("benchmarks.scaling", shape, size)
            if child.returncode != 0:
                raise ScalingError(f"measuring {shape} {size} failed: {child.stderr.strip()[-200:]}")
            yield Scale(**json.loads(child.stdout))


def scaling_table(scales: Iterable[Scale]) -> list[str]:
    """Return the results as lines; the exponent of the step's time over nodes refers to the previous mesh."""
    rows: list[tuple[str, ...]] = [HEAD]
    before: Scale | None = None
    for each in scales:
        exponent = "-"
        if before is not None and before.shape == each.shape:
            slope = math.log(each.step_ms / before.step_ms) / math.log(each.nodes / before.nodes)
            exponent = f"{slope:.2f}"
        rows.append(
            (
                each.shape,
                each.size,
                str(each.nodes),
                str(each.elements),
                f"{each.plan_s:.2f}",
                f"{each.step_ms:.1f}",
                f"{each.solve_ms:.1f}",
                str(each.iterations or "-"),
                f"{each.threads_ms:.1f} ({each.threads})",
                f"{each.speed_up:.2f}",
                "-" if each.splu_ms is None else f"{each.splu_ms:.1f}",
                f"{each.factor_entries / 1e6:.2f} M",
                f"{each.flops / 1e9:.3f}",
                f"{each.peak_mb:.0f}",
                exponent,
            )
        )
        before = each
    return align_columns(rows)


if __name__ == "__main__":
    sys.stdout.write(json.dumps(measure_scale(*sys.argv[1:3]).as_json()))
