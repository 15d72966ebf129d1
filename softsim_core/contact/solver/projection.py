"""The contact law with its corners smoothed, so that it has a derivative everywhere: smoothed projection."""

from __future__ import annotations

from math import inf, sqrt
from typing import NamedTuple

import numpy as np

from softsim_core.arrays import Array
from softsim_core.contact.solver.compile import kernel
from softsim_core.contact.solver.law import ContactProblem, friction_of, largest_tangential


class Smoothed(NamedTuple):
    """Forces moved against their gaps and projected into smoothed bounds and cones.

    Attributes:
        forces: In [N], shape (r,).
        slope: Their derivative with respect to what is projected: one number for a bounded row, a row of
            three for each row of a contact, shape (r, 3).
    """

    forces: Array
    slope: Array


@kernel
def steepness(problem: ContactProblem) -> Array:
    """How far in [N/m] each row's force is moved for a gap before it is projected; 0: nothing moves it."""
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
    r"""Move forces against their gaps and bring them back into rounded bounds and cones.

    Forces that this does not change fulfil the rounded law: of a contact that rests, force times gap is
    `energy`; at 0 it is the law itself. The gap of a contact with friction is raised by its slip, so that
    force and gap both lie in cones that are dual to each other:
    :math:`(\mu f_n, f_t)` and :math:`(g_n / \mu + |g_t|, g_t)`.

    Args:
        problem: The rows; neither its compliance nor its gaps matter.
        steep: See steepness(), shape (r,).
        energy: How round the corners are, in [J].
        forces: In [N], shape (r,).
        gaps: In [m], shape (r,).
        smoothed: Filled.

    Returns:
        Sum of squared differences between forces and projected ones, over their steepness, in [J].

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
    """The positive part with a rounded corner: half of value + sqrt(value^2 + 4 round_off)."""
    root = sqrt(value * value + 4.0 * round_off)
    if value > 0.0:
        return 0.5 * (value + root)
    return 2.0 * round_off / (root - value) if root > value else 0.0  # without cancellation


@kernel
def _rise(value: float, round_off: float) -> float:
    """Derivative of the rounded positive part."""
    root = sqrt(value * value + 4.0 * round_off)
    return 0.5 + 0.5 * value / root if root > 0.0 else 0.5
