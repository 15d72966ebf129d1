"""A few coupled forces with bounds, exactly: the multipliers of actuators.

The forces minimise f^T C f / 2 + gap . f within their bounds. Active sets find them in a few linear solves,
and seldom run in circles; then faces of the bounds are walked instead, each minimum lower than the one
before, which ends. What comes out is checked.
"""

from __future__ import annotations

import numpy as np

from softsim_core.base import Array, BoolArray

SOLVED = 1e-9
"""Forces with a larger `bounded_residual` are no answer."""

WRONG_SIDE = 1e-12
"""A remainder on the wrong side of a bound counts from this share of what adds up in its row."""

SMALLEST_PIVOT = 1e-15
"""Pivots are at least this part of the diagonal, so that rows that say the same can be solved for."""

FACES_PER_FORCE = 100
"""Faces that are walked at most for each force; a handful is usual."""


def solve_bounded(compliance: Array, gap: Array, lower: Array, upper: Array) -> Array:
    """Forces f in [N] with gap + C f = 0, or f at a bound that gap + C f pushes against, shape (c,).

    At the lower bound the remainder gap + C f is >= 0, at the upper one <= 0.

    Args:
        compliance: C in [m/N], symmetric and positive definite, shape (c, c).
        gap: In [m] at zero forces, shape (c,).
        lower: Lower bounds in [N], shape (c,); -inf is none.
        upper: Upper bounds, shape (c,), inf is none; equal ones impose the force.

    Returns:
        The forces; NaN where none meet the conditions to SOLVED: C is not positive definite, or a value is
        not finite.

    Source: Hintermueller, Ito and Kunisch 2002, The primal-dual active set strategy; Stark and Parker 1995,
    Bounded-variable least squares (the walk over faces).
    """
    if not np.isfinite(gap.sum() + compliance.sum()):
        return np.full(len(gap), np.nan)
    for way in (_active_sets, _faces):
        try:
            forces = way(compliance, gap, lower, upper)
        except np.linalg.LinAlgError:  # exactly singular
            continue
        if bounded_residual(compliance, gap, lower, upper, forces) <= SOLVED:
            return forces
    return np.full(len(gap), np.nan)


def bounded_residual(compliance: Array, gap: Array, lower: Array, upper: Array, forces: Array) -> float:
    """How far forces (c,) are from the conditions of `solve_bounded`, in shares of what adds up in a row.

    Row i adds up gap and the terms of C f, of size up to sqrt(C_ii C_jj) |f_j|: rounding leaves 1e-16 of it.
    Infinite out of bounds, NaN where a force is.
    """
    if not ((forces >= lower) & (forces <= upper)).all():
        return float("nan" if np.isnan(forces).any() else "inf")
    remainder = gap + compliance @ forces
    below = np.where(forces > lower, remainder, 0.0)  # pushes down, and there is room
    above = np.where(forces < upper, -remainder, 0.0)
    worst = np.maximum(below, above)
    return float((worst / _sums(compliance, gap, forces)).max(initial=0.0))


def _sums(compliance: Array, gap: Array, forces: Array) -> Array:
    """Sizes in [m] of what adds up in each row, > 0, shape (c,)."""
    root = np.sqrt(np.abs(compliance.diagonal()))
    sums = np.abs(gap).max(initial=0.0) + root * (root @ np.abs(forces))
    return np.asarray(np.maximum(sums, np.finfo(float).tiny))


def _active_sets(compliance: Array, gap: Array, lower: Array, upper: Array) -> Array:
    """Release what leaves its bounds, hold what turns back, all at once; may end without an answer."""
    held = lower < upper
    if held.all():
        forces = -np.linalg.solve(compliance, gap)
        if (forces >= lower).all() and (forces <= upper).all():
            return np.asarray(forces)  # the common case: no bound is reached
    forces = np.where(held, 0.0, lower)
    for _ in range(2 * len(gap) + 1):
        if held.any():
            rest = gap[held] + compliance[np.ix_(held, ~held)] @ forces[~held]
            forces[held] = -np.linalg.solve(compliance[np.ix_(held, held)], rest)
        remainder = gap + compliance @ forces
        bound = np.clip(forces, lower, upper)
        release = held & (bound != forces)
        tiny = WRONG_SIDE * _sums(compliance, gap, forces)
        back = np.where(forces <= lower, remainder < -tiny, remainder > tiny)
        catch = ~held & (lower < upper) & back
        if not release.any() and not catch.any():
            return forces
        forces = np.where(release, bound, forces)
        held = (held & ~release) | catch
    return np.asarray(np.clip(forces, lower, upper))


def _faces(compliance: Array, gap: Array, lower: Array, upper: Array) -> Array:
    """Minimum of one face of the bounds after another; the force pushed off most frees the next face."""
    forces = np.clip(np.zeros(len(gap)), lower, upper)
    held = (lower < forces) & (forces < upper)
    settled = lower >= upper
    freed = -1
    for _ in range(FACES_PER_FORCE * len(gap)):
        if _to_minimum(compliance, gap, (lower, upper), forces, held):
            settled = lower >= upper
        elif freed >= 0:
            settled[freed] = True  # it goes nowhere: what pushed it is rounding
        remainder = gap + compliance @ forces
        push = np.where(forces <= lower, -remainder, remainder) / _sums(compliance, gap, forces)
        push[held | settled] = 0.0
        freed = int(np.argmax(push))
        if not push[freed] > WRONG_SIDE:  # also ends on NaN
            break
        held[freed] = True
    return forces


def _to_minimum(
    compliance: Array, gap: Array, bounds: tuple[Array, Array], forces: Array, held: BoolArray
) -> bool:
    """Move `forces` (c,) to the minimum over those held, which leave `held` at a bound; whether any moved."""
    lower, upper = bounds
    moved = False
    while held.any():
        rest = gap[held] + compliance[np.ix_(held, ~held)] @ forces[~held]
        goal = forces.copy()
        goal[held] = -_solve_positive(compliance[np.ix_(held, held)], rest)
        change, bound = goal - forces, np.clip(goal, lower, upper)
        beyond = np.flatnonzero(bound != goal)
        shares = (bound - forces)[beyond] / change[beyond]
        part = float(shares.min(initial=1.0))
        moved = moved or (part > 0.0 and bool(change.any()))
        if not len(beyond):
            forces[:] = goal
            break
        first = beyond[int(np.argmin(shares))]
        forces[held] = np.clip(forces + part * change, lower, upper)[held]
        forces[first] = bound[first]
        held[first] = False
    return moved


def _solve_positive(matrix: Array, right: Array) -> Array:
    """Solution of a symmetric system, its eigenvalues (diagonal scaled to 1) at least SMALLEST_PIVOT."""
    scale = 1.0 / np.sqrt(np.maximum(matrix.diagonal(), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(scale[:, None] * matrix * scale)
    return np.asarray(
        scale * (vectors @ ((vectors.T @ (scale * right)) / np.maximum(values, SMALLEST_PIVOT)))
    )
