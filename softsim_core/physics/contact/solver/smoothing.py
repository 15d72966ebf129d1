"""Newton's method on a smoothed contact law whose corners are sharpened step by step."""

from __future__ import annotations

from math import inf, sqrt
from typing import NamedTuple

import numpy as np

from softsim_core.base import Array, IndexArray
from softsim_core.physics.contact import kernel
from softsim_core.physics.contact.solver.law import (
    ContactProblem,
    eliminate,
    friction_of,
    gaps_under,
    into_bounds,
    largest_tangential,
    moved_friction,
    violation,
)


class Smoothed(NamedTuple):
    """Forces moved against their gaps and projected into smoothed bounds and cones.

    Attributes:
        forces: Projected forces in [N], shape (r,).
        slope: Derivative by the unprojected forces: one number for a bounded row, three for each row of a
            contact, shape (r, 3).
    """

    forces: Array
    slope: Array


@kernel
def steepness(problem: ContactProblem) -> Array:
    """Return the change of each row's force per gap in [N/m] before projection; 0: no force moves the row."""
    compliance, bounded = problem.compliance, problem.lower.shape[0]
    rows = compliance.shape[0]
    steep = np.zeros(rows)
    for i in range(bounded):
        steep[i] = 1.0 / compliance[i, i] if compliance[i, i] > 0.0 else 0.0
    for i in range(bounded, rows, 3):
        compliant, friction = compliance[i, i], friction_of(i, problem)
        if compliant > 0.0 and friction > 0.0:
            compliant = max(compliant / friction**2, largest_tangential(i, compliance))
        steep[i : i + 3] = 1.0 / compliant if compliant > 0.0 else 0.0
    return steep


@kernel
def project(
    problem: ContactProblem,
    steep: Array,
    energy: float,
    forces: Array,
    gaps: Array,
    smoothed: Smoothed,
) -> float:
    r"""Move forces against their gaps and project them into rounded bounds and cones.

    Forces that this leaves unchanged satisfy the rounded law: force times gap of a resting contact is
    `energy`; at 0 it is the exact law. The gap of a contact with friction is increased by its slip, so that
    force and gap are in cones that are dual to each other:
    :math:`(\mu f_n, f_t)` and :math:`(g_n / \mu + |g_t|, g_t)`.

    Args:
        problem: The rows; neither its compliance nor its gaps are used.
        steep: See steepness(), shape (r,).
        energy: Roundness of the corners, in [J].
        forces: Forces in [N], shape (r,).
        gaps: Gaps in [m], shape (r,).
        smoothed: Filled.

    Returns:
        Sum of squared differences between forces and projected forces, over their steepness, in [J].

    Source: de Saxcé and Feng 1998 (the raised gap); Fukushima, Luo, Tseng 2001 (the rounded projection).
    """
    bounded, off = problem.lower.shape[0], 0.0
    for i in range(bounded, forces.shape[0], 3):
        friction = friction_of(i, problem)
        if friction > 0.0 and steep[i] > 0.0:
            off += _project_cone(i, friction, steep[i], energy, forces, gaps, smoothed)
        else:
            smoothed.forces[i + 1] = smoothed.forces[i + 2] = 0.0
            off += _project_row(i, (0.0, inf), steep[i], energy, forces, gaps, smoothed)
    for i in range(bounded):
        bounds = (problem.lower[i], problem.upper[i])
        off += _project_row(i, bounds, steep[i], energy, forces, gaps, smoothed)
    return off


@kernel
def _project_row(
    i: int,
    bounds: tuple[float, float],
    steep: float,
    energy: float,
    forces: Array,
    gaps: Array,
    smoothed: Smoothed,
) -> float:
    """Project force i into its bounds."""
    (lower, upper), projected, slope = bounds, smoothed.forces, smoothed.slope
    if steep == 0.0:
        projected[i], slope[i, 0] = forces[i], 0.0
        return 0.0
    moved, round_off = forces[i] - steep * gaps[i], steep * energy
    force, rise = moved, 1.0
    if lower > -inf:
        force, rise = lower + _positive(moved - lower, round_off), _rise(moved - lower, round_off)
        if upper < inf:
            force -= _positive(moved - upper, round_off)
            rise -= _rise(moved - upper, round_off)
    elif upper < inf:
        force, rise = upper - _positive(upper - moved, round_off), _rise(upper - moved, round_off)
    projected[i], slope[i, 0] = force, rise
    return float((forces[i] - force) ** 2 / steep)


@kernel
def _project_cone(
    i: int, friction: float, steep: float, energy: float, forces: Array, gaps: Array, smoothed: Smoothed
) -> float:
    """Project the force of rows i by its two spectral values, normal component -+ tangential size."""
    projected, slope = smoothed.forces, smoothed.slope
    slip = sqrt(gaps[i + 1] ** 2 + gaps[i + 2] ** 2)
    normal = friction * forces[i] - steep * (gaps[i] / friction + slip)
    u, v = forces[i + 1] - steep * gaps[i + 1], forces[i + 2] - steep * gaps[i + 2]
    size, round_off = sqrt(u * u + v * v), steep * energy
    e, f = (u / size, v / size) if size > 0.0 else (1.0, 0.0)
    low, high = _positive(normal - size, round_off), _positive(normal + size, round_off)
    low_rise, high_rise = _rise(normal - size, round_off), _rise(normal + size, round_off)
    mean, half = 0.5 * (high_rise + low_rise), 0.5 * (high_rise - low_rise)
    turn = 0.5 * (high - low) / size if size > 0.0 else mean
    projected[i] = 0.5 * (high + low) / friction
    projected[i + 1], projected[i + 2] = 0.5 * (high - low) * e, 0.5 * (high - low) * f
    slope[i, 0], slope[i, 1], slope[i, 2] = mean, half * e, half * f
    slope[i + 1, 0], slope[i + 2, 0] = half * e, half * f
    slope[i + 1, 1], slope[i + 2, 2] = turn + (mean - turn) * e * e, turn + (mean - turn) * f * f
    slope[i + 1, 2] = slope[i + 2, 1] = (mean - turn) * e * f
    off = (friction * (forces[i] - projected[i])) ** 2
    off += (forces[i + 1] - projected[i + 1]) ** 2 + (forces[i + 2] - projected[i + 2]) ** 2
    return float(off / steep)


@kernel
def _positive(value: float, round_off: float) -> float:
    """Return the positive part with a rounded corner: half of value + sqrt(value^2 + 4 round_off)."""
    root = sqrt(value * value + 4.0 * round_off)
    if value > 0.0:
        return 0.5 * (value + root)
    return 2.0 * round_off / (root - value) if root > value else 0.0  # without cancellation


@kernel
def _rise(value: float, round_off: float) -> float:
    """Return the derivative of the rounded positive part."""
    root = sqrt(value * value + 4.0 * round_off)
    return 0.5 + 0.5 * value / root if root > 0.0 else 0.5


_STEPS = 40
"""Number of Newton steps; the corners are sharpened after each."""
_OPEN = 1.0e-2
"""A row whose projection has a smaller slope than this counts as being at its bound within a step."""
_SHORTEST = 0.01
"""Smallest share of a step that is tried."""


class _System(NamedTuple):
    """Linear system of a Newton step: numbers of active rows (n,), matrix (n, n), right-hand side (n,)."""

    active: IndexArray
    matrix: Array
    right: Array


@kernel
def solve_by_sharpening(problem: ContactProblem, forces: Array, roundness: float, tolerance: float) -> float:
    """Improve `forces` where redundant contacts stick, slide and open in ways that iterations do not resolve.

    With smooth corners, every contact close to touching has a force, and the system is regular even where the
    compliance is singular. The forces then follow as the corners are sharpened. `roundness` is the initial
    smoothness relative to the violation of the law by `forces`.

    Returns:
        The residual in [m] of the best forces found, see law.violation(); converged if below `tolerance`.

    Source: Chen and Mangasarian 1996 (smoothing); Hayashi, Yamashita, Fukushima 2005 (second-order cones).
    """
    rows = problem.gap.shape[0]
    steep = steepness(problem)
    smoothed = Smoothed(np.zeros(rows), np.zeros((rows, 3)))
    trial_smoothed = Smoothed(np.zeros(rows), np.zeros((rows, 3)))
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
            trial_off = project(problem, steep, energy, trial, trial_state, trial_smoothed)
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
    """Undo the effect of smooth corners: zero force in open contacts, full friction in sliding ones."""
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
    """Return the factor for the roundness after a step of size `share`; a short one makes it rounder."""
    if share == 1.0:
        return 0.2
    if share >= 0.5:
        return 0.5
    return 1.0 if share >= 0.1 else 2.0


@kernel
def _newton_aim(
    problem: ContactProblem, steep: Array, forces: Array, state: Array, smoothed: Smoothed
) -> Array:
    """Return forces that equal their projection, linearised about `forces`; rows at a bound take it."""
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
    """Add rows i to i + width to the active ones, unless they are at their bound; return the new number."""
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
    """Fill rows a to a + 3 of Newton's system for a contact with friction."""
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
