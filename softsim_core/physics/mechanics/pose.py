"""Rotations and poses: exponential map, Euler angles, quaternions (x, y, z, w)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from softsim_core.base import Array


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """Position in [m], shape (3,), and unit quaternion (x, y, z, w), shape (4,), of a frame in the world."""

    position: Array
    quaternion_xyzw: Array


def cross_matrix(vector: Array) -> Array:
    """Return the matrix [v]x with [v]x w = v x w; `vector` of shape (3,), result (3, 3)."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def cross_matrices(vectors: Array) -> Array:
    """Return the cross matrices of vectors (..., 3), shape (..., 3, 3)."""
    result = np.zeros((*vectors.shape, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        result[..., i, j], result[..., j, i] = -vectors[..., k], vectors[..., k]
    return result


def cross(a: Array, b: Array) -> Array:
    """Return cross products of vectors (..., 3); np.cross takes several times as long for a few of them."""
    result = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        result[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return result


def rotation_exp(rotation_vector: Array) -> Array:
    """Return the rotation matrix (3, 3) of a rotation vector (3,) in [rad] (Rodrigues)."""
    x, y, z = rotation_vector.tolist()
    angle = math.sqrt(x * x + y * y + z * z)
    if angle < 1e-8:
        a, b = 1.0, 0.5
    elif angle < math.inf:
        a, b = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle**2
    else:
        a = b = math.nan
    return np.array(
        [
            [1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y],
            [b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x],
            [b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)],
        ]
    )


def rotation_log(rotation: Array) -> Array:
    """Return the rotation vector (3,) in [rad], of length at most pi, of a rotation matrix (3, 3)."""
    x, y, z, w = quaternion_of(rotation)
    sine = float(np.sqrt(x * x + y * y + z * z))
    if sine < 1e-12:
        return 2.0 * np.array([x, y, z])
    return np.asarray(2.0 * np.arctan2(sine, w) / sine * np.array([x, y, z]))


def nearest_rotation(before: Array, after: Array) -> Array:
    """Return the rotation R (3, 3) with the least squares of after - R before.

    Both have shape (n, 3) and are taken about their means.

    Source: Kabsch 1976, with the proper rotation of Umeyama 1991.
    """
    u, _, vt = np.linalg.svd(before.T @ after)
    sign = np.sign(np.linalg.det(u @ vt))
    return np.asarray(((u * (1.0, 1.0, sign)) @ vt).T)


def rotation_euler(angles: Array) -> Array:
    """Return the rotation Rz(c) Ry(b) Rx(a) of angles (a, b, c) in [rad] about the fixed axes x, y, z."""
    (ca, cb, cc), (sa, sb, sc) = np.cos(angles), np.sin(angles)
    return np.array(
        [
            [cb * cc, sa * sb * cc - ca * sc, ca * sb * cc + sa * sc],
            [cb * sc, sa * sb * sc + ca * cc, ca * sb * sc - sa * cc],
            [-sb, sa * cb, ca * cb],
        ]
    )


def euler_of(rotation: Array) -> Array:
    """Return the angles (a, b, c) in [rad] of `rotation_euler`, shape (3,).

    |b| is at most pi/2; if it is equal to pi/2, c is 0.
    """
    (xx, _, _), (yx, yy, yz), (zx, zy, zz) = rotation.tolist()
    flat = math.hypot(xx, yx)
    if flat < 1e-9:  # x and z turn about one line: a is the whole angle
        return np.array([math.atan2(-yz, yy), math.atan2(-zx, flat), 0.0])
    return np.array([math.atan2(zy, zz), math.atan2(-zx, flat), math.atan2(yx, xx)])


def quaternion_of(rotation: Array) -> Array:
    """Return the unit quaternion (x, y, z, w), w >= 0, of a rotation matrix (3, 3).

    The computation starts from its largest component.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rotation.tolist()
    squares = (1.0 + xx - yy - zz, 1.0 - xx + yy - zz, 1.0 - xx - yy + zz, 1.0 + xx + yy + zz)
    a, b, c = zy - yz, xz - zx, yx - xy
    d, e, f = xy + yx, xz + zx, yz + zy
    candidates = (
        (squares[0], d, e, a),
        (d, squares[1], f, b),
        (e, f, squares[2], c),
        (a, b, c, squares[3]),
    )
    quaternion = np.array(candidates[squares.index(max(squares))])
    length = math.sqrt(quaternion @ quaternion)
    return quaternion / (length if quaternion[3] >= 0.0 else -length)


def rotation_of(quaternion_xyzw: Array) -> Array:
    """Return the rotation matrix (3, 3) of a unit quaternion (x, y, z, w)."""
    x, y, z, w = np.asarray(quaternion_xyzw, dtype=float).tolist()
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
