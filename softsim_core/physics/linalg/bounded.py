"""Exact solution for a few coupled forces with bounds, such as the multipliers of actuators.

The forces minimise f^T C f / 2 + gap . f within their bounds. Active sets find them in a few linear solves,
and seldom cycle. If they do, faces of the bounds are visited instead, each with a lower minimum than the one
before, which terminates. The result is checked.
"""

from __future__ import annotations

import numpy as np

from softsim_core.base import Array, BoolArray

SOLVED = 1e-9
"""Largest `bounded_residual` of a solution."""

WRONG_SIDE = 1e-12
"""Share of the terms in a row above which a remainder on the wrong side of a bound counts."""

SMALLEST_PIVOT = 1e-15
"""Smallest pivot as a share of the diagonal, so that identical rows can be solved for."""

FACES_PER_FORCE = 100
"""Largest number of faces visited for each force; a handful is usual."""


def solve_bounded(compliance: Array, gap: Array, lower: Array, upper: Array) -> Array:
    """Return forces f in [N] with gap + C f = 0, or f at a bound that gap + C f pushes against, shape (c,).

    At the lower bound the remainder gap + C f is >= 0, at the upper one <= 0.

    Args:
        compliance: C in [m/N], symmetric and positive definite, shape (c, c).
        gap: Gap in [m] at zero forces, shape (c,).
        lower: Lower bounds in [N], shape (c,); -inf for none.
        upper: Upper bounds in [N], shape (c,); inf for none; equal bounds impose the force.

    Returns:
        The forces; NaN if none satisfy the conditions to SOLVED, because C is not positive definite or a
        value is not finite.

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
    """Return how far forces (c,) violate the conditions of `solve_bounded`, relative to the terms in a row.

    The terms of row i are the gap and those of C f, of size up to sqrt(C_ii C_jj) |f_j|; rounding leaves
    1e-16 of them. It is infinite out of bounds, NaN where a force is NaN.
    """
    if not ((forces >= lower) & (forces <= upper)).all():
        return float("nan" if np.isnan(forces).any() else "inf")
    remainder = gap + compliance @ forces
    below = np.where(forces > lower, remainder, 0.0)  # pushes down, and the bound is not reached
    above = np.where(forces < upper, -remainder, 0.0)
    worst = np.maximum(below, above)
    return float((worst / _sums(compliance, gap, forces)).max(initial=0.0))


def _sums(compliance: Array, gap: Array, forces: Array) -> Array:
    """Return the magnitude in [m] of the terms in each row, > 0, shape (c,)."""
    root = np.sqrt(np.abs(compliance.diagonal()))
    sums = np.abs(gap).max(initial=0.0) + root * (root @ np.abs(forces))
    return np.asarray(np.maximum(sums, np.finfo(float).tiny))


def _active_sets(compliance: Array, gap: Array, lower: Array, upper: Array) -> Array:
    """Solve by active sets, releasing and holding rows all at once; may end without a solution."""
    active = lower < upper
    if active.all():
        forces = -np.linalg.solve(compliance, gap)
        if (forces >= lower).all() and (forces <= upper).all():
            return np.asarray(forces)  # the common case: no bound is reached
    forces = np.where(active, 0.0, lower)
    for _ in range(2 * len(gap) + 1):
        if active.any():
            rest = gap[active] + compliance[np.ix_(active, ~active)] @ forces[~active]
            forces[active] = -np.linalg.solve(compliance[np.ix_(active, active)], rest)
        remainder = gap + compliance @ forces
        bound = np.clip(forces, lower, upper)
        release = active & (bound != forces)
        tiny = WRONG_SIDE * _sums(compliance, gap, forces)
        back = np.where(forces <= lower, remainder < -tiny, remainder > tiny)
        catch = ~active & (lower < upper) & back
        if not release.any() and not catch.any():
            return forces
        forces = np.where(release, bound, forces)
        active = (active & ~release) | catch
    return np.asarray(np.clip(forces, lower, upper))


def _faces(compliance: Array, gap: Array, lower: Array, upper: Array) -> Array:
    """Minimise over one face of the bounds after another.

    The force pushed off its bound most is freed next.
    """
    forces = np.clip(np.zeros(len(gap)), lower, upper)
    active = (lower < forces) & (forces < upper)
    settled = lower >= upper
    freed = -1
    for _ in range(FACES_PER_FORCE * len(gap)):
        if _to_minimum(compliance, gap, (lower, upper), forces, active):
            settled = lower >= upper
        elif freed >= 0:
            settled[freed] = True  # it does not move: the push was rounding
        remainder = gap + compliance @ forces
        push = np.where(forces <= lower, -remainder, remainder) / _sums(compliance, gap, forces)
        push[active | settled] = 0.0
        freed = int(np.argmax(push))
        if not push[freed] > WRONG_SIDE:  # also ends on NaN
            break
        active[freed] = True
    return forces


def _to_minimum(
    compliance: Array, gap: Array, bounds: tuple[Array, Array], forces: Array, active: BoolArray
) -> bool:
    """Move `forces` (c,) to the minimum over the held ones, which leave `active` at a bound.

    Return whether any moved.
    """
    lower, upper = bounds
    moved = False
    while active.any():
        rest = gap[active] + compliance[np.ix_(active, ~active)] @ forces[~active]
        trial = forces.copy()
        trial[active] = -_solve_positive(compliance[np.ix_(active, active)], rest)
        change, bound = trial - forces, np.clip(trial, lower, upper)
        beyond = np.flatnonzero(bound != trial)
        shares = (bound - forces)[beyond] / change[beyond]
        part = float(shares.min(initial=1.0))
        moved = moved or (part > 0.0 and bool(change.any()))
        if not len(beyond):
            forces[:] = trial
            break
        first = beyond[int(np.argmin(shares))]
        forces[active] = np.clip(forces + part * change, lower, upper)[active]
        forces[first] = bound[first]
        active[first] = False
    return moved


def _solve_positive(matrix: Array, right: Array) -> Array:
    """Solve a symmetric system with eigenvalues (diagonal scaled to 1) of at least SMALLEST_PIVOT."""
    scale = 1.0 / np.sqrt(np.maximum(matrix.diagonal(), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(scale[:, None] * matrix * scale)
    return np.asarray(
        scale * (vectors @ ((vectors.T @ (scale * right)) / np.maximum(values, SMALLEST_PIVOT)))
    )
