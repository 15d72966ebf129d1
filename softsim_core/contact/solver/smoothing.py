"""Newton's method on the smoothed contact law, whose corners are sharpened step by step."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.contact.solver.compile import kernel
from softsim_core.contact.solver.elimination import eliminate
from softsim_core.contact.solver.law import (
    ContactProblem,
    friction_of,
    gaps_under,
    into_bounds,
    moved_friction,
    violation,
)
from softsim_core.contact.solver.projection import Smoothed, project, steepness

_STEPS = 40
"""Newton steps; after each the corners are sharpened."""
_OPEN = 1.0e-2
"""A row whose projection rises less than this is taken as being at its bound within a step."""
_SHORTEST = 0.01
"""Least share of a step that is tried."""


class _System(NamedTuple):
    """Newton's system over the rows that are solved for.

    Attributes:
        active: Numbers of these rows, shape (n,).
        matrix: Shape (n, n).
        right: Right-hand side, shape (n,).
    """

    active: IndexArray
    matrix: Array
    right: Array


@kernel
def solve_by_sharpening(problem: ContactProblem, forces: Array, roundness: float, tolerance: float) -> float:
    """Improve `forces` where redundant contacts stick, slide and open in ways that no iteration sorts out.

    With smooth corners every contact near touching has a force, and the system is regular even where the
    compliance is singular; the forces then follow as the corners are sharpened. `roundness` tells how smooth
    they are at first, relative to the violation of the law by `forces`.

    Returns:
        The residual in [m] of the best forces found, see law.violation(); good enough below `tolerance`.

    Source: Chen and Mangasarian 1996 (smoothing); Hayashi, Yamashita, Fukushima 2005 (second-order cones).
    """
    rows = problem.gap.shape[0]
    steep = steepness(problem)
    smoothed = Smoothed(np.zeros(rows), np.zeros((rows, 3)))
    tried = Smoothed(np.zeros(rows), np.zeros((rows, 3)))
    state = gaps_under(problem, forces)
    residual, _ = violation(problem, state, forces)
    energy = roundness * residual**2 * rows / max(np.trace(problem.compliance), 1e-300)
    path = forces.copy()
    for _ in range(_STEPS):
        if residual <= tolerance:
            break
        off = project(problem, steep, energy, path, state, smoothed)
        aim = _newton_aim(problem, steep, path, state, smoothed)
        share = 1.0
        while True:
            trial = path + share * (aim - path)
            trial_state = gaps_under(problem, trial)
            trial_off = project(problem, steep, energy, trial, trial_state, tried)
            if trial_off < off * (1.0 - 0.1 * share) or share < _SHORTEST:
                break
            share *= 0.5
        path, state = trial, trial_state
        admissible = path.copy()
        _square_off(problem, state, admissible)
        into_bounds(problem, admissible)
        there, _ = violation(problem, gaps_under(problem, admissible), admissible)
        if there < residual:
            residual = there
            forces[:] = admissible
        energy *= _sharper(share)
    return residual


@kernel
def _square_off(problem: ContactProblem, state: Array, forces: Array) -> None:
    """Undo what smooth corners do: open contacts have no force, sliding ones all the friction there is."""
    for i in range(problem.lower.shape[0], forces.shape[0], 3):
        friction = friction_of(i, problem)
        if forces[i] * problem.compliance[i, i] < state[i]:
            forces[i : i + 3] = 0.0
        elif friction > 0.0:
            u, v = moved_friction(i, problem, forces, state)
            if sqrt(u * u + v * v) > friction * forces[i] * (1.0 - 1.0e-12):
                forces[i + 1], forces[i + 2] = u, v


@kernel
def _sharper(share: float) -> float:
    """Factor for the roundness after a step of which `share` was taken: rounder again after a short one."""
    if share == 1.0:
        return 0.2
    if share >= 0.5:
        return 0.5
    return 1.0 if share >= 0.1 else 2.0


@kernel
def _newton_aim(
    problem: ContactProblem, steep: Array, forces: Array, state: Array, smoothed: Smoothed
) -> Array:
    """Forces that equal their projection, linearised about `forces`; open contacts go where they are led."""
    compliance, bounded = problem.compliance, problem.lower.shape[0]
    projected, slope = smoothed.forces, smoothed.slope
    aim = projected.copy()
    active = np.zeros(forces.shape[0], dtype=np.int64)
    size = 0
    for i in range(bounded):
        size = _activate(i, 1, slope, active, size, forces, aim)
    first = size
    for i in range(bounded, forces.shape[0], 3):
        size = _activate(i, 3 if friction_of(i, problem) > 0.0 else 1, slope, active, size, forces, aim)
    change = gaps_under(problem, aim) - state
    system = _System(active[:size], np.empty((size, size)), np.empty(size))
    a = 0
    while a < size:
        i = active[a]
        if a >= first and friction_of(i, problem) > 0.0:
            _contact_rows(a, problem, steep, forces, state, change, smoothed, system)
            a += 3
            continue
        factor = slope[i, 0] * steep[i]
        for b in range(size):
            system.matrix[a, b] = factor * compliance[i, active[b]]
        system.matrix[a, a] += 1.0 - slope[i, 0]
        system.right[a] = projected[i] - forces[i] - factor * change[i]
        a += 1
    eliminate(system.matrix, system.right)
    for a in range(size):
        aim[active[a]] += system.right[a]
    return aim


@kernel
def _activate(
    i: int, width: int, slope: Array, active: IndexArray, size: int, forces: Array, aim: Array
) -> int:
    """Let rows i to i + width be solved for, from `forces`, unless they are at their bound; the new size."""
    if slope[i, 0] <= _OPEN:
        return size
    for d in range(width):
        active[size + d] = i + d
        aim[i + d] = forces[i + d]
    return size + width


@kernel
def _contact_rows(
    a: int,
    problem: ContactProblem,
    steep: Array,
    forces: Array,
    state: Array,
    change: Array,
    smoothed: Smoothed,
    system: _System,
) -> None:
    """Rows a to a + 3 of Newton's matrix: a contact with friction."""
    compliance, projected, slope = problem.compliance, smoothed.forces, smoothed.slope
    active, matrix, right = system.active, system.matrix, system.right
    i = active[a]
    friction = friction_of(i, problem)
    slip = sqrt(state[i + 1] ** 2 + state[i + 2] ** 2)
    e, f = (state[i + 1] / slip, state[i + 2] / slip) if slip > 0.0 else (0.0, 0.0)
    for d in range(3):
        scale = 1.0 / friction if d == 0 else 1.0
        along = scale * slope[i + d, 0]
        first, second = scale * slope[i + d, 1], scale * slope[i + d, 2]
        p = steep[i] * along / friction
        q, r = steep[i] * (first + along * e), steep[i] * (second + along * f)
        for b in range(right.shape[0]):
            j = active[b]
            matrix[a + d, b] = p * compliance[i, j] + q * compliance[i + 1, j] + r * compliance[i + 2, j]
        matrix[a + d, a + d] += 1.0
        matrix[a + d, a] -= along * friction
        matrix[a + d, a + 1] -= first
        matrix[a + d, a + 2] -= second
        right[a + d] = projected[i + d] - forces[i + d]
        right[a + d] -= p * change[i] + q * change[i + 1] + r * change[i + 2]
