"""The compiled twin of linalg.bounded: coupled forces with bounds, the multipliers of actuators."""

from __future__ import annotations

from math import inf, nan, sqrt

import numpy as np

from softsim_core.arrays import Array, BoolArray
from softsim_core.dynamics.numba_backend.compile import kernel
from softsim_core.linalg.bounded import FACES_PER_FORCE, SMALLEST_PIVOT, SOLVED, WRONG_SIDE

TINY = float(np.finfo(float).tiny)


@kernel
def bounded_forces(matrix: Array, gap: Array, lower: Array, upper: Array, forces: Array) -> None:
    """Forces (c,) in [N] as linalg.bounded.solve_bounded finds them; NaN where there is no answer."""
    size = len(gap)
    factor, sums, held = np.empty((size, size)), np.empty(size), np.empty(size, np.bool_)
    active_sets(matrix, gap, lower, upper, forces, factor, sums, held)
    if residual_of(matrix, gap, lower, upper, forces, sums) <= SOLVED:
        return
    walk_faces(matrix, gap, lower, upper, forces, factor, sums, held)
    if not residual_of(matrix, gap, lower, upper, forces, sums) <= SOLVED:
        for c in range(size):
            forces[c] = nan


@kernel
def remainder_of(matrix: Array, gap: Array, forces: Array, c: int) -> float:
    """Row c of gap + matrix . forces."""
    rest = gap[c]
    for d in range(len(gap)):
        rest += matrix[c, d] * forces[d]
    return float(rest)


@kernel
def sum_rows(matrix: Array, gap: Array, forces: Array, sums: Array) -> None:
    """Sizes of what adds up in each row into `sums` (c,)."""
    size, most, reach = len(gap), 0.0, 0.0
    for c in range(size):
        most = max(most, abs(gap[c]))
        reach += sqrt(abs(matrix[c, c])) * abs(forces[c])
    for c in range(size):
        sums[c] = max(most + sqrt(abs(matrix[c, c])) * reach, TINY)


@kernel
def residual_of(matrix: Array, gap: Array, lower: Array, upper: Array, forces: Array, sums: Array) -> float:
    """See linalg.bounded.bounded_residual; infinite where a force is NaN."""
    sum_rows(matrix, gap, forces, sums)
    worst = 0.0
    for c in range(len(gap)):
        if not (lower[c] <= forces[c] <= upper[c]):
            return inf
        rest = remainder_of(matrix, gap, forces, c) / sums[c]
        if not abs(rest) < inf:
            return inf
        if forces[c] > lower[c]:
            worst = max(worst, rest)
        if forces[c] < upper[c]:
            worst = max(worst, -rest)
    return worst


@kernel
def solve_held(matrix: Array, gap: Array, held: BoolArray, forces: Array, factor: Array) -> None:
    """Forces of the held rows so that gap + matrix . forces = 0 there; the others are given."""
    size = len(gap)
    for i in range(size):
        if not held[i]:
            continue
        forces[i] = -gap[i]
        for j in range(size):
            factor[i, j] = matrix[i, j]
            if not held[j]:
                forces[i] -= matrix[i, j] * forces[j]
    for i in range(size):
        if not held[i]:
            continue
        if factor[i, i] < SMALLEST_PIVOT * matrix[i, i]:
            factor[i, i] = SMALLEST_PIVOT * matrix[i, i]
        scale = 1.0 / sqrt(factor[i, i])
        forces[i] *= scale
        for j in range(i, size):
            factor[i, j] *= scale
        for k in range(i + 1, size):
            if held[k]:
                forces[k] -= factor[i, k] * forces[i]
                for j in range(k, size):
                    factor[k, j] -= factor[i, k] * factor[i, j]
    for i in range(size - 1, -1, -1):
        if held[i]:
            for j in range(i + 1, size):
                if held[j]:
                    forces[i] -= factor[i, j] * forces[j]
            forces[i] /= factor[i, i]


@kernel
def active_sets(
    matrix: Array, gap: Array, lower: Array, upper: Array, forces: Array, factor: Array, sums: Array,
    held: BoolArray,
) -> None:  # fmt: skip
    """Release what leaves its bounds, hold what turns back, all at once; may end without an answer."""
    size = len(gap)
    hold = np.empty(size, np.bool_)
    for c in range(size):
        held[c] = lower[c] < upper[c]
        forces[c] = 0.0 if held[c] else lower[c]
    for _ in range(2 * size + 1):
        solve_held(matrix, gap, held, forces, factor)
        sum_rows(matrix, gap, forces, sums)
        settled = True
        for c in range(size):
            if held[c]:
                hold[c] = lower[c] <= forces[c] <= upper[c]
            else:
                rest = remainder_of(matrix, gap, forces, c)
                tiny = WRONG_SIDE * sums[c]
                back = rest < -tiny if forces[c] <= lower[c] else rest > tiny
                hold[c] = back and lower[c] < upper[c]
            settled = settled and hold[c] == held[c]
        if settled:
            return
        for c in range(size):
            held[c] = hold[c]
            forces[c] = min(max(forces[c], lower[c]), upper[c])


@kernel
def walk_faces(
    matrix: Array, gap: Array, lower: Array, upper: Array, forces: Array, factor: Array, sums: Array,
    held: BoolArray,
) -> None:  # fmt: skip
    """Minimum of one face of the bounds after another; the force that is pushed off most frees the next."""
    size, freed = len(gap), -1
    settled, goal = np.empty(size, np.bool_), np.empty(size)
    for c in range(size):
        forces[c] = min(max(0.0, lower[c]), upper[c])
        held[c] = lower[c] < forces[c] < upper[c]
        settled[c] = False
    for _ in range(FACES_PER_FORCE * size):
        if to_minimum(matrix, gap, lower, upper, forces, factor, goal, held):
            settled[:] = False
        elif freed >= 0:
            settled[freed] = True  # it goes nowhere: what pushed it is rounding
        sum_rows(matrix, gap, forces, sums)
        most, freed = WRONG_SIDE, -1
        for c in range(size):
            if held[c] or settled[c] or not lower[c] < upper[c]:
                continue
            push = remainder_of(matrix, gap, forces, c) / sums[c]
            if forces[c] <= lower[c]:
                push = -push
            if push > most:
                most, freed = push, c
        if freed < 0:
            return
        held[freed] = True


@kernel
def to_minimum(
    matrix: Array, gap: Array, lower: Array, upper: Array, forces: Array, factor: Array, goal: Array,
    held: BoolArray,
) -> bool:  # fmt: skip
    """Move `forces` to the minimum over those held, which leave `held` at a bound; whether any moved."""
    size, moved = len(gap), False
    for _ in range(size + 1):
        goal[:] = forces
        solve_held(matrix, gap, held, goal, factor)
        part, first = 1.0, -1
        for c in range(size):
            if held[c] and not lower[c] <= goal[c] <= upper[c]:
                bound = upper[c] if goal[c] > upper[c] else lower[c]
                share = (bound - forces[c]) / (goal[c] - forces[c])
                if first < 0 or share < part:
                    part, first = share, c
        for c in range(size):
            if held[c]:
                moved = moved or (part > 0.0 and goal[c] != forces[c])
                if first < 0:
                    forces[c] = goal[c]
                else:
                    after = forces[c] + part * (goal[c] - forces[c])
                    forces[c] = min(max(after, lower[c]), upper[c])
        if first < 0:
            break
        forces[first] = upper[first] if goal[first] > upper[first] else lower[first]
        held[first] = False
    return moved
