"""Nearest rotation to a matrix, one at a time, whatever the matrix: the fallback of the vector code."""

from __future__ import annotations

from math import sqrt

import numpy as np

from softsim_core.arrays import Array
from softsim_core.dynamics.numba_backend.compile import kernel


@kernel
def rotate_lanes(lanes: int, deformation: Array, rotations: Array) -> None:
    """Rotations (9, LANES) of deformation gradients (9, LANES), where the lane's bit is set in `lanes`."""
    f, r = np.empty((3, 3)), np.empty((3, 3))
    for lane in range(deformation.shape[1]):
        if (lanes >> lane) & 1:
            for i in range(9):
                f[i // 3, i % 3] = deformation[i, lane]
            nearest_rotation(f, r)
            for i in range(9):
                rotations[i, lane] = r[i // 3, i % 3]


@kernel
def nearest_rotation(f: Array, r: Array) -> None:
    """Nearest proper rotation r (3, 3) to f (3, 3), in the Frobenius norm.

    Source: Markley 1993. With the nuclear-like norm k = s1 + s2 + sign(det) s3 the largest root of
    (k^2 - |f|^2)^2 - 8 k det f - 4 |adj f|^2 = 0, found by Newton from above:
    r = ((a + |f|^2) f + k adj(f)^T - f f^T f) / (a k - det f), a = (k^2 - |f|^2) / 2.
    """
    c00 = f[1, 1] * f[2, 2] - f[1, 2] * f[2, 1]
    c01 = f[1, 2] * f[2, 0] - f[1, 0] * f[2, 2]
    c02 = f[1, 0] * f[2, 1] - f[1, 1] * f[2, 0]
    c10 = f[0, 2] * f[2, 1] - f[0, 1] * f[2, 2]
    c11 = f[0, 0] * f[2, 2] - f[0, 2] * f[2, 0]
    c12 = f[0, 1] * f[2, 0] - f[0, 0] * f[2, 1]
    c20 = f[0, 1] * f[1, 2] - f[0, 2] * f[1, 1]
    c21 = f[0, 2] * f[1, 0] - f[0, 0] * f[1, 2]
    c22 = f[0, 0] * f[1, 1] - f[0, 1] * f[1, 0]
    det = f[0, 0] * c00 + f[0, 1] * c01 + f[0, 2] * c02
    cc = c00 * c00 + c01 * c01 + c02 * c02 + c10 * c10 + c11 * c11 + c12 * c12
    cc += c20 * c20 + c21 * c21 + c22 * c22
    ff = 0.0
    for i in range(3):
        for j in range(3):
            ff += f[i, j] * f[i, j]
    k = sqrt(3.0 * ff)
    for _ in range(40):
        p = k * k - ff
        slope = 4.0 * k * p - 8.0 * det
        if slope <= 0.0:
            break
        step = (p * p - 8.0 * k * det - 4.0 * cc) / slope
        k -= step
        if step <= 1e-15 * k:
            break
    a = 0.5 * (k * k - ff)
    denominator = a * k - det
    if denominator <= 1e-9 * k * k * k:
        _frame_of_columns(f, r)
        return
    s = 1.0 / denominator
    for i in range(3):
        # row i of f f^T f
        d0 = f[i, 0] * f[0, 0] + f[i, 1] * f[0, 1] + f[i, 2] * f[0, 2]
        d1 = f[i, 0] * f[1, 0] + f[i, 1] * f[1, 1] + f[i, 2] * f[1, 2]
        d2 = f[i, 0] * f[2, 0] + f[i, 1] * f[2, 1] + f[i, 2] * f[2, 2]
        for j in range(3):
            r[i, j] = (a + ff) * f[i, j] - (d0 * f[0, j] + d1 * f[1, j] + d2 * f[2, j])
    r[0, 0] = s * (r[0, 0] + k * c00)
    r[0, 1] = s * (r[0, 1] + k * c01)
    r[0, 2] = s * (r[0, 2] + k * c02)
    r[1, 0] = s * (r[1, 0] + k * c10)
    r[1, 1] = s * (r[1, 1] + k * c11)
    r[1, 2] = s * (r[1, 2] + k * c12)
    r[2, 0] = s * (r[2, 0] + k * c20)
    r[2, 1] = s * (r[2, 1] + k * c21)
    r[2, 2] = s * (r[2, 2] + k * c22)


@kernel
def _frame_of_columns(f: Array, r: Array) -> None:
    """A proper rotation from the columns of f by Gram and Schmidt, whatever is degenerate."""
    for j in range(2):
        for i in range(3):
            r[i, j] = f[i, j]
        if j == 1:
            dot = r[0, 0] * r[0, 1] + r[1, 0] * r[1, 1] + r[2, 0] * r[2, 1]
            for i in range(3):
                r[i, 1] -= dot * r[i, 0]
        length = sqrt(r[0, j] ** 2 + r[1, j] ** 2 + r[2, j] ** 2)
        if length < 1e-12:  # any direction will do: the least aligned axis, made normal to the first column
            least = 0
            if j == 1:
                for i in range(1, 3):
                    if abs(r[i, 0]) < abs(r[least, 0]):
                        least = i
            for i in range(3):
                r[i, j] = 1.0 if i == least else 0.0
            if j == 1:
                dot = r[least, 0]
                for i in range(3):
                    r[i, 1] -= dot * r[i, 0]
            length = sqrt(r[0, j] ** 2 + r[1, j] ** 2 + r[2, j] ** 2)
        for i in range(3):
            r[i, j] /= length
    r[0, 2] = r[1, 0] * r[2, 1] - r[2, 0] * r[1, 1]
    r[1, 2] = r[2, 0] * r[0, 1] - r[0, 0] * r[2, 1]
    r[2, 2] = r[0, 0] * r[1, 1] - r[1, 0] * r[0, 1]
