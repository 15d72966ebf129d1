"""Compiled corotational elasticity in cells of any nodes; the formulas of fem.materials.corotational.

In principal stretches theta = s1 + s2 + s3 - 3 and psi_i = 2 mu (s_i - 1) + p; of the tangent only the modes
that turn can be negative: b_l = 2 mu - 2 gamma / (s_i + s_j), gamma = 2 mu - p.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types

from softsim_core.arrays import Array
from softsim_core.dynamics.numba_backend.compile import kernel
from softsim_core.dynamics.numba_backend.lanes import Batch, Lanes, Matrix, contraction, difference
from softsim_core.dynamics.numba_backend.point_cells import (
    Given,
    Into,
    PointCells,
    deform,
    finish,
    press,
)
from softsim_core.dynamics.numba_backend.point_lanes import POINT_ROWS
from softsim_core.dynamics.numba_backend.principal_lanes import (
    put_modes,
    put_principal,
    put_stretches,
    signed_stretches,
)
from softsim_core.dynamics.numba_backend.relaxation import Memory, remember
from softsim_core.fem.materials.corotational import SMALLEST_VOLUME, Corotational
from softsim_core.fem.materials.isotropic import lame
from softsim_core.linalg.compile import intrinsic


def corotational_moduli(law: Corotational, p: Array) -> Array:
    """Mu in [Pa], shape (m, 1)."""
    return np.asarray(lame(p)[1][:, None])


def _rotation(u: Matrix, v: Matrix) -> Matrix:
    """U V^T of columns."""
    return [[u[0][i] * v[0][j] + u[1][i] * v[1][j] + u[2][i] * v[2][j] for j in range(3)] for i in range(3)]


@intrinsic
def put_rotation(typing: Any, points: Any, row: Any) -> Any:
    """Rows 18 to 30 of a point from its stretches; row 28 is that of the present deformation."""
    signature = types.void(points, types.int64)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        b = Batch(context, builder)
        point = b.start(signature.args[0], args[0], args[1])
        s, u, v = b.load(point, 3, 104), b.load_matrix(point, 86), b.load_matrix(point, 95)
        r = [[u[i][0] * v[j][0] + u[i][1] * v[j][1] + u[i][2] * v[j][2] for j in range(3)] for i in range(3)]
        theta = s[0] + s[1] + s[2] - 3.0
        b.put_matrix(point, 18, r)
        b.put(point, 27, theta)
        b.put(point, 28, theta)
        b.put(point, 29, contraction(r, b.load_matrix(point, 9)))
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def put_found(typing: Any, points: Any, row: Any, moved: Any, place: Any) -> Any:
    """Row 28 of a point; `moved`: gradient of what the last solve moved, nine rows from `place` on."""
    signature = types.void(points, types.int64, moved, types.int64)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        b = Batch(context, builder)
        point = b.start(signature.args[0], args[0], args[1])
        step = b.load_matrix(b.start(signature.args[2], args[2], args[3]))
        f = b.load_matrix(point)
        u, _, v = signed_stretches(b, [difference(f[i], step[i]) for i in range(3)])
        b.put(point, 28, contraction(_rotation(u, v), f) - 3.0)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def put_corotational(typing: Any, points: Any, row: Any, moduli: Any, place: Any, positive: Any) -> Any:
    """Psi, h, a and b of a point; moduli: a_p, one more, and mu in rows from `place` on."""
    signature = types.void(points, types.int64, moduli, types.int64, types.boolean)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        b, kinds = Batch(context, builder), signature.args
        point = b.start(kinds[0], args[0], args[1])
        at_point, _, mu = b.load(b.start(kinds[2], args[2], args[3]), 3)
        s, (now, found) = b.load(point, 3, 104), b.load(point, 2, 84)
        double = mu * 2.0
        gamma, sums = double - found, [s[1] + s[2], s[2] + s[0], s[0] + s[1]]
        within = [gamma.below(mu * each) for each in sums]
        all_within = builder.and_(within[0], builder.and_(within[1], within[2]))
        zero = mu * 0.0
        volume = (sums[0] * sums[1] * sums[2]).at_least(zero.where(all_within, SMALLEST_VOLUME))
        twist = []
        for k in range(3):
            share = gamma * sums[(k + 1) % 3] * sums[(k + 2) % 3] / volume
            turning = _choose(b, args[4], mu.where(within[k], share), gamma / sums[k])
            twist.append(double - turning * 2.0)
        h = [at_point + double if i == j else at_point for i in range(3) for j in range(i, 3)]
        put_principal(b, point, [double * (each - 1.0) + now for each in s], h, [double] * 3, twist)
        return context.get_dummy_value()

    return signature, generate


def _choose(b: Batch, which: Any, one: Lanes, other: Lanes) -> Lanes:
    """The one if the bit holds, else the other, in all lanes."""
    return Lanes(b.v, b.builder.select(which, one.value, other.value))


@kernel
def corotational_points(batch: int, given: Given, cells: PointCells) -> None:
    """Stress and tangent of all points of a batch."""
    points, steps, weights, moduli = cells.room.points, cells.room.steps, cells.weights, cells.moduli
    batches = len(cells.cells.nodes)
    count, place = len(weights) // batches, batch * (len(moduli) // batches)
    deform(batch, given, cells)
    for q in range(count):
        put_stretches(points, POINT_ROWS * q)
        put_rotation(points, POINT_ROWS * q)
        if len(given.moved):
            put_found(points, POINT_ROWS * q, steps, 9 * q)
    press(batch, cells)
    for q in range(count):
        put_corotational(points, POINT_ROWS * q, moduli, place, given.positive)
        put_modes(points, POINT_ROWS * q, weights, count * batch + q)


@kernel
def fill_corotational(given: Given, cells: PointCells, into: Into) -> None:
    """Add forces and stiffness of all cells."""
    for batch in range(len(cells.cells.nodes)):
        corotational_points(batch, given, cells)
        finish(batch, given, cells, into)


@kernel
def remember_corotational(given: Given, cells: PointCells, memory: Memory) -> None:
    """Take over in the memory of all cells what a step has done."""
    for batch in range(len(cells.cells.nodes)):
        corotational_points(batch, given, cells)
        remember(batch, cells, memory)
