r"""How fast inverse control may move a robot: shares of one tick, from the slowest period of its model.

With x the effector, u where it comes to rest under the present commands and g the goal, control moves u by

    du/dt = k (g - x) + c (x - u),

the second term damping actively. A mode of frequency w with damping b = r_M + r_K w^2 gives the polynomial
s^3 + (c + b) s^2 + (w^2 + b c) s + k w^2, stable for all k, c > 0 that leave k w^2 below
(c + b) (w^2 + b c): faster modes are stable, too. The largest k puts three poles at one place:

    a = (b + sqrt((4 w^2 - b^2) / 3)) / 2,    k = a^3 / w^2,    c = 3 a - b        (b < 2 w)

A mode that creeps (b >= 2 w) gets two poles at its slower one p: k = c = p. A tick takes the shares
1 - exp(-k dt) and 1 - exp(-c dt), below 1 at any dt.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh

from softsim_core.mechanics.rows import Rows
from softsim_core.simulation import Simulation

LEAST_MASS = 1e-9
"""Part of the mean inertia that each shape has at least: the shapes of a flat body are dependent."""


class Pace(NamedTuple):
    """Parts of what is missing that one tick makes up for.

    Attributes:
        full: Of the error, were every mode fast.
        approach: Of the error between goal and effector.
        catch_up: Of the way that the effector still has to go to rest.
        rate: k in [1/s].
    """

    full: float
    approach: float
    catch_up: float
    rate: float


def pace(rate: float, period: float, damping: tuple[float, float], dt: float) -> Pace:
    """The shares of a tick.

    Args:
        rate: Largest k in [1/s].
        period: Slowest period in [s]; 0: everything follows at once.
        damping: r_M in [1/s] and r_K in [s], what the time integration adds included.
        dt: Time of a tick in [s].
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
    """Period in [s] of the slowest mode with joints at their commands; 0 without bodies.

    The largest quotient of a load's work on the deflection it causes and its shape's own, over loads that
    are accelerations linear in space, of each body: with V the shapes (3 n, s) and M the masses,

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
    inertia += LEAST_MASS * np.trace(inertia) / len(inertia) * np.eye(len(inertia))  # a flat body has fewer
    largest = float(eigh(deflection, inertia, eigvals_only=True)[-1])
    return 2.0 * math.pi * math.sqrt(max(largest, 0.0))
