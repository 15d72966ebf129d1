"""A few coupled forces with bounds, exactly: the tensions of cables."""

from __future__ import annotations

import numpy as np

from softsim_core.arrays import Array


def solve_bounded(compliance: Array, gap: Array, lower: Array, upper: Array) -> Array:
    """Forces f in [N] with gap + C f = 0, or f at a bound that gap + C f pushes against, shape (c,).

    At the lower bound the remainder gap + C f is >= 0, at the upper one <= 0. Active sets: release what
    leaves its bounds, hold what turns back.

    Args:
        compliance: C in [m/N], symmetric and positive definite, shape (c, c).
        gap: In [m] at zero forces, shape (c,).
        lower: Lower bounds in [N], shape (c,).
        upper: Upper bounds, shape (c,); equal ones impose the force.

    Source: Hintermueller, Ito and Kunisch 2002, The primal-dual active set strategy.
    """
    held = lower < upper
    if held.all():
        forces = -np.linalg.solve(compliance, gap)
        if (forces >= lower).all() and (forces <= upper).all():
            return np.asarray(forces)  # the common case: every cable is taut
    forces = np.where(held, 0.0, lower)
    for _ in range(2 * len(gap) + 1):
        if held.any():
            rest = gap[held] + compliance[np.ix_(held, ~held)] @ forces[~held]
            forces[held] = -np.linalg.solve(compliance[np.ix_(held, held)], rest)
        remainder = gap + compliance @ forces
        bound = np.clip(forces, lower, upper)
        release = held & (bound != forces)
        tiny = 1e-12 * np.abs(gap).max(initial=0.0)
        back = np.where(forces <= lower, remainder < -tiny, remainder > tiny)
        catch = ~held & (lower < upper) & back
        if not release.any() and not catch.any():
            return forces
        forces = np.where(release, bound, forces)
        held = (held & ~release) | catch
    return np.asarray(np.clip(forces, lower, upper))
