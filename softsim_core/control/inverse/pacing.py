"""Speed of inverse control: shares of one tick, and damping that adapts from tick to tick.

A program needs little damping both far from the goal and near it. Where a goal is out of reach, or the
effector hardly moves with its joints, increments would oscillate. Damping slows a step and moves no
equilibrium.

Source: Nocedal and Wright 2006, ch. 10 (Levenberg-Marquardt).

With x the effector, u the position at which it comes to rest under the present commands and g the goal,
control moves u by

    du/dt = k (g - x) + c (x - u),

where the second term provides active damping. A mode of frequency w with damping b = r_M + r_K w^2 gives the
polynomial s^3 + (c + b) s^2 + (w^2 + b c) s + k w^2. It is stable for all k, c > 0 with k w^2 below
(c + b) (w^2 + b c), so faster modes are stable, too. The largest k puts three poles at one place:

    a = (b + sqrt((4 w^2 - b^2) / 3)) / 2,    k = a^3 / w^2,    c = 3 a - b        (b < 2 w)

An overdamped mode (b >= 2 w) gets two poles at its slower one p: k = c = p. A tick takes the shares
1 - exp(-k dt) and 1 - exp(-c dt), which are below 1 at any dt.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh

from softsim_core.base import Array
from softsim_core.physics.mechanics import Rows
from softsim_core.simulation import Simulation

LEAST = 1e-6
"""Damping of a steady approach, as a part of the largest mean curvature since the start."""

CAUTION, TRUST, MOST = 4.0, 0.95, 1000.0
"""Damping grows by CAUTION, up to MOST, when an increment reverses the last one; else it shrinks by TRUST."""

TIRING, PROGRESS = 1.04, 1e-5
"""Each tick without progress towards a missed goal, by a part PROGRESS of the distance, raises the least
damping by TIRING, so that slow modes of a soft body that keep oscillating come to rest.
"""

PACE = 0.2
"""The distance is measured by its last peak, which decays at this part of the rate of control.

A path that oscillates past the goal is near it for a moment. Compared with that moment, the steady approach
afterwards would count as no progress, and the damping would stop it. The peaks of a persistent oscillation do
not decay.
"""

LONGEST = 1000
"""Largest count of ticks without progress."""

NOISE = 1e-9
"""Increments below this, in units of Limits.scale, are ignored in the detection of oscillations."""


class AdaptiveDamping:
    """Adaptive damping of the next program.

    Args:
        size: Number of joints j.
        lever: Length in [m] that converts angles to distances.
    """

    def __init__(self, size: int, lever: float) -> None:
        self._lever = lever
        self._curvature = 0.0
        self._last = np.zeros(size)
        self.rest()

    @property
    def stalled(self) -> float:
        """Consecutive ticks, up to LONGEST, without progress towards a missed goal."""
        return self._stalled

    def rest(self) -> None:
        """Reset the adaptation for another goal."""
        self._share, self._stalled, self._peak, self._best = LEAST, 0.0, 0.0, math.inf

    def at(self, effector: Array) -> float:
        """Return the damping in [m^2] for a sensitivity of the effector per Limits.scale, shape (6, j)."""
        shift, turn = effector[:3], self._lever * effector[3:]
        curvature = float(np.vdot(shift, shift) + np.vdot(turn, turn)) / shift.shape[1]
        self._curvature = max(self._curvature, curvature)
        return self._share * self._curvature

    def learn(self, dq: Array, distance: float, *, there: bool, approach: float, weight: float = 1.0) -> None:
        """Update the damping after a tick; without progress towards a missed goal it only grows.

        Args:
            dq: Increments of the tick in units of Limits.scale, shape (j,).
            distance: Distance from the goal after the tick in [m], with angles converted by the lever.
            there: Whether the goal counts as reached.
            approach: Share of the distance that a tick removes.
            weight: Weight of the tick among those without progress, less than 1 where slow modes need time.
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


LEAST_MASS = 1e-9
"""Least inertia of each shape as a part of the mean inertia: the shapes of a flat body are dependent."""


class Pace(NamedTuple):
    """Parts of the remaining error or motion that one tick removes.

    Attributes:
        full: Of the error, if every mode were fast.
        approach: Of the error between goal and effector.
        catch_up: Of the effector's remaining motion to its rest position.
        rate: k in [1/s].
    """

    full: float
    approach: float
    catch_up: float
    rate: float


def pace(rate: float, period: float, damping: tuple[float, float], dt: float) -> Pace:
    """Return the shares of a tick.

    Args:
        rate: Largest k in [1/s].
        period: Slowest period in [s]; 0: the effector follows without delay.
        damping: r_M in [1/s] and r_K in [s], including the damping of the time integration.
        dt: Duration of a tick in [s].
    """
    k = c = math.inf
    if period > 0.0:
        w = 2.0 * math.pi / period
        b = damping[0] + damping[1] * w * w
        if b < 2.0 * w:
            a = 0.5 * (b + math.sqrt((4.0 * w * w - b * b) / 3.0))
            k, c = a**3 / w**2, 3.0 * a - b
        else:
            k = c = 2.0 * w * w / (b + math.sqrt(b * b - 4.0 * w * w))
    k = min(k, rate)
    full, approach, catch_up = (1.0 - math.exp(-each * dt) for each in (rate, k, c))
    return Pace(full, approach, catch_up, k)


def slowest_period(simulation: Simulation) -> float:
    """Return the period in [s] of the slowest mode with joints at their commands; 0 without bodies.

    The period follows from the largest quotient of a load's work on the deflection it causes and its work
    on its own shape. The loads are accelerations of each body that are linear in space. With V the shapes
    (3 n, s) and M the masses,

        (V^T M K^-1 M V) y = (T / 2 pi)^2 (V^T M V) y

    Source: Rayleigh's quotient of an inertial load, Clough and Penzien 2003, ch. 8.

    Raises:
        LinAlgError: the state has no stable equilibrium.
    """
    model, positions = simulation.model, simulation.positions
    nodes = np.arange(len(positions))
    shapes = []
    for body in simulation.bodies:
        own = positions[body.nodes]
        local = own - own.mean(axis=0)
        for values in (np.ones(len(own)), *(local / max(float(np.abs(local).max()), 1e-300)).T):
            for axis in range(3):
                shape = np.zeros_like(positions)
                shape[body.nodes, axis] = values
                shapes.append(shape)
    if not shapes:
        return 0.0
    loads = [model.momentum(shape) for shape in shapes]
    rows = Rows(len(nodes) * np.arange(len(loads) + 1), np.tile(nodes, len(loads)), np.concatenate(loads))
    deflection = simulation.static_response(rows).rows_by_row
    inertia = np.reshape(shapes, (len(shapes), -1)) @ np.reshape(loads, (len(loads), -1)).T
    inertia += LEAST_MASS * np.trace(inertia) / len(inertia) * np.eye(len(inertia))  # a flat body is singular
    largest = float(eigh(deflection, inertia, eigvals_only=True)[-1])
    return 2.0 * math.pi * math.sqrt(max(largest, 0.0))
