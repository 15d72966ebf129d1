"""How much the increments of inverse control are damped, learned from tick to tick.

Far from the goal and near it a program wants little damping; where a goal is out of reach, or the effector
hardly moves with its joints, increments would swing. Damping slows a step and moves no equilibrium.

Source: Nocedal and Wright 2006, ch. 10 (Levenberg-Marquardt).
"""

from __future__ import annotations

import math

import numpy as np

from softsim_core.arrays import Array

LEAST = 1e-6
"""Damping of a calm approach, as a part of the largest mean curvature seen since the start."""

CAUTION, TRUST, MOST = 4.0, 0.95, 1000.0
"""Damping grows by CAUTION when an increment turns back on the last one, up to MOST, and shrinks by TRUST
otherwise."""

TIRING, PROGRESS = 1.04, 1e-5
"""Each tick without progress towards a missed goal, by a part PROGRESS of the distance, raises the least
damping by TIRING: what the slow modes of a soft body keep swinging comes to rest."""

PACE = 0.2
"""A distance counts as its last peak, which fades at this part of the rate of control: a path that swings
past the goal is near it for a moment. Measured by that moment, the calm approach after it would be no
progress, and the damping would stop it. The peaks of a swing that lasts stay where they are."""

LONGEST = 1000
"""Ticks without progress that count."""

NOISE = 1e-9
"""Increments below this, in units of Limits.scale, tell nothing about swinging."""


class AdaptiveDamping:
    """Damping of the next program.

    Args:
        size: Number of joints j.
        lever: Length in [m] at which an angle counts.
    """

    def __init__(self, size: int, lever: float) -> None:
        self._lever = lever
        self._curvature = 0.0
        self._last = np.zeros(size)
        self.rest()

    @property
    def stalled(self) -> float:
        """Ticks in a row, up to LONGEST, without progress towards a missed goal."""
        return self._stalled

    def rest(self) -> None:
        """Another goal: what was learned about the last one is forgotten."""
        self._share, self._stalled, self._peak, self._best = LEAST, 0.0, 0.0, math.inf

    def at(self, effector: Array) -> float:
        """Damping in [m^2] of a program with this sensitivity of the effector per Limits.scale, (6, j)."""
        shift, turn = effector[:3], self._lever * effector[3:]
        curvature = float(np.vdot(shift, shift) + np.vdot(turn, turn)) / shift.shape[1]
        self._curvature = max(self._curvature, curvature)
        return self._share * self._curvature

    def learn(self, dq: Array, distance: float, *, there: bool, approach: float, weight: float = 1.0) -> None:
        """Take note of a tick; without progress towards a missed goal the damping only grows.

        Args:
            dq: Its increments in units of Limits.scale, shape (j,).
            distance: From the goal after it in [m], an angle counted at the lever.
            there: Whether that counts as reached.
            approach: Share of the distance that a tick takes away.
            weight: Of the tick among those without progress: less than 1 where slow modes want patience.
        """
        self._peak = max(distance, (1.0 - PACE * approach) * self._peak)
        progress = there or self._peak < (1.0 - PROGRESS) * self._best
        self._stalled = 0.0 if progress else min(self._stalled + weight, LONGEST)
        self._best = min(self._best, self._peak)
        noticeable = min(float(np.abs(dq).max()), float(np.abs(self._last).max())) > NOISE
        if noticeable and float(dq @ self._last) < 0.0:
            self._share = min(CAUTION * self._share, MOST)
        else:
            self._share = max(TRUST * self._share, min(LEAST * TIRING**self._stalled, MOST))
        self._last = dq
