"""Compare preconditioners of a large step: iterations, seconds and memory of each, on one thread.

From the checkout: `.softsim/venv/bin/python -m benchmarks.preconditioners 10k 30k`, with PyAMG installed in
the environment (`pip install pyamg`); nothing else uses it. The matrix is that of the next step of the bodies
of `bench --scaling`, the right-hand side is gravity, and all iterate until the velocity of each node is
within 1e-6 m/s of the solution, which is 1e-8 m per step.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from time import process_time
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import cg, spilu

from benchmarks.records import align_columns
from benchmarks.scaling import SHAPES, build_clamped_simulation, measure_planning, mesh_of
from benchmarks.steps import step_matrix
from softsim_core import Simulation
from softsim_core.base import Array

TOLERANCE = 1e-6
"""Largest difference of a velocity from the solution in [m/s]."""

MOST = 300
"""Largest number of iterations."""

GRID = 5
"""Nodes of the coarse grid along each axis: two quadratic cells."""


class Row(NamedTuple):
    """What one preconditioner takes: seconds once, iterations and seconds of a solution, and megabytes."""

    name: str
    once_s: float
    iterations: int
    solve_s: float
    megabytes: float


def rigid_modes(points: Array) -> Array:
    """Return translations and rotations of nodes (n, 3), shape (3 n, 6)."""
    x, y, z = (points - points.mean(axis=0)).T
    modes = np.zeros((len(points), 3, 6))
    modes[:, :, :3] = np.eye(3)
    modes[:, 1, 3], modes[:, 2, 3] = -z, y
    modes[:, 0, 4], modes[:, 2, 4] = z, -x
    modes[:, 0, 5], modes[:, 1, 5] = -y, x
    return modes.reshape(-1, 6)


def quadratic_space(points: Array) -> sp.csr_matrix:
    """Return shape functions of a grid of quadratic cells at nodes (n, 3), for three axes, (3 n, 3 g)."""
    low, high = points.min(axis=0), points.max(axis=0)
    cells = (GRID - 1) // 2
    place = (points - low) / (high - low) * cells
    cell = np.minimum(place.astype(int), cells - 1)
    t = place - cell
    along = np.stack([(2 * t - 1) * (t - 1), 4 * t * (1 - t), t * (2 * t - 1)], axis=-1)
    values, columns = np.ones((len(points), 1)), np.zeros((len(points), 1), int)
    for axis in range(3):
        values = (values[:, :, None] * along[:, axis, None]).reshape(len(points), -1)
        nodes = 2 * cell[:, axis, None] + np.arange(3)
        columns = (columns[:, :, None] * GRID + nodes[:, None]).reshape(len(points), -1)
    rows = np.repeat(np.arange(len(points)), values.shape[1])
    shape = (len(points), GRID**3)
    scalar = sp.csr_matrix((values.ravel(), (rows, columns.ravel())), shape=shape)
    return sp.csr_matrix(sp.kron(scalar, sp.eye(3)))


def megabytes_of(*matrices: Any) -> float:
    """Return the memory of sparse matrices."""
    parts = [part for each in matrices for part in (each.data, each.indices, each.indptr)]
    return float(sum(part.nbytes for part in parts) / 1e6)


def algebraic_multigrid(matrix: Any, points: Array) -> tuple[Callable[[Array], Array], float]:
    """Return a V-cycle of smoothed aggregation with the rigid modes, and its megabytes."""
    import pyamg

    blocks = matrix.tobsr((3, 3))
    smoother = ("block_gauss_seidel", {"sweep": "symmetric"})
    levels = pyamg.smoothed_aggregation_solver(
        blocks, B=rigid_modes(points), presmoother=smoother, postsmoother=smoother, max_coarse=300
    )
    size = megabytes_of(*(each.A for each in levels.levels), *(each.P for each in levels.levels[:-1]))
    return levels.aspreconditioner().matvec, size


def incomplete_factor(matrix: Any, points: Array) -> tuple[Callable[[Array], Array], float]:
    """Return an incomplete factor in single precision, about four times as large as the matrix."""
    factor = spilu(matrix.astype(np.float32).tocsc(), drop_tol=1e-3, fill_factor=4.0)
    size = 8.0 * (factor.L.nnz + factor.U.nnz) / 1e6
    return lambda b: np.asarray(factor.solve(b.astype(np.float32)), dtype=float), size


def coarse_quadratic(matrix: Any, points: Array) -> tuple[Callable[[Array], Array], float]:
    """Return Gauss-Seidel sweeps around a solution in a coarse space of quadratic cells."""
    from pyamg.relaxation.relaxation import block_gauss_seidel

    blocks, space = matrix.tobsr((3, 3)), quadratic_space(points)
    inverse = np.linalg.pinv((space.T @ matrix @ space).toarray(), hermitian=True)

    def apply(b: Array) -> Array:
        x = np.zeros_like(b)
        block_gauss_seidel(blocks, x, b, iterations=1, sweep="forward", blocksize=3)
        x += space @ (inverse @ (space.T @ (b - blocks @ x)))
        block_gauss_seidel(blocks, x, b, iterations=1, sweep="backward", blocksize=3)
        return x

    return apply, megabytes_of(space) + inverse.nbytes / 1e6


KINDS = {
    "algebraic multigrid, rigid modes": algebraic_multigrid,
    "incomplete factor, single precision": incomplete_factor,
    "coarse quadratic space": coarse_quadratic,
}


def measured(name: str, matrix: Any, b: Array, points: Array, solution: Array) -> Row:
    """Measure one of KINDS by conjugate gradients, at most 300 iterations."""
    started = process_time()
    apply, size = KINDS[name](matrix, points)
    once = process_time() - started
    started, iterations = process_time(), 0
    x, r = np.zeros_like(b), b.copy()
    z = apply(r)
    p, rz = z.copy(), r @ z
    while iterations < MOST and np.abs(x - solution).max() > TOLERANCE:
        ap = matrix @ p
        step = rz / (p @ ap)
        x, r = x + step * p, r - step * ap
        z = apply(r)
        before, rz = rz, r @ z
        p, iterations = z + (rz / before) * p, iterations + 1
    return Row(name, once, iterations, process_time() - started, size)


def ours(shape: str, size: str) -> tuple[Simulation, Row]:
    """Return a simulation after four steps, and what its own preconditioner takes in the last one."""
    simulation = build_clamped_simulation(mesh_of(shape, size), threads=1)
    times = []
    for _ in range(4):
        started = process_time()
        simulation.step()
        times.append(process_time() - started)
    stages = simulation.stage_times
    share = stages["factor" if "factor" in stages else "iterate"] / stages["step"]
    entries = measure_planning(simulation.model)[1]
    once, iterations = times[0] - times[-1], simulation.report.linear_iterations
    return simulation, Row(
        "ours: factor at rest, rotated", once, iterations, share * times[-1], 4e-6 * entries
    )


def rows(shape: str, size: str) -> Iterator[Row]:
    """Measure all preconditioners on one body."""
    import pyamg

    simulation, own = ours(shape, size)
    yield own
    matrix = step_matrix(simulation).tocsr()
    points = simulation.model.rest[simulation.model.free_nodes]
    fall = -9.81 * simulation.model.dt * simulation.model.mass[simulation.model.free_nodes]
    b = np.outer(fall, [0.0, 0.0, 1.0]).ravel()
    levels = pyamg.smoothed_aggregation_solver(matrix.tobsr((3, 3)), B=rigid_modes(points))
    solution, _ = cg(matrix, b, rtol=1e-13, maxiter=2000, M=levels.aspreconditioner())
    for name in KINDS:
        yield measured(name, matrix, b, points, solution)


if __name__ == "__main__":
    table: list[tuple[str, ...]] = [("body", "preconditioner", "once s", "iterations", "solution s", "MB")]
    for size in sys.argv[1:] or ["10k"]:
        for shape in SHAPES:
            for each in rows(shape, size):
                once, solve, memory = f"{each.once_s:.2f}", f"{each.solve_s:.3f}", f"{each.megabytes:.0f}"
                table.append((f"{shape} {size}", each.name, once, str(each.iterations), solve, memory))
    sys.stdout.write("\n".join(align_columns(table)) + "\n")
