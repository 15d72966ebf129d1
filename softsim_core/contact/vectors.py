"""Vectors of three numbers as tuples, for the contact kernels: they stay in registers."""

from __future__ import annotations

from math import sqrt
from typing import TypeAlias

from softsim_core.arrays import Array
from softsim_core.contact.compile import kernel

Vector: TypeAlias = tuple[float, float, float]


@kernel
def row(points: Array, i: int) -> Vector:
    """Row i of an array (n, 3)."""
    return points[i, 0], points[i, 1], points[i, 2]


@kernel
def add(a: Vector, b: Vector) -> Vector:
    """A + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@kernel
def minus(a: Vector, b: Vector) -> Vector:
    """A - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel
def scaled(a: Vector, factor: float) -> Vector:
    """A times a number."""
    return a[0] * factor, a[1] * factor, a[2] * factor


@kernel
def dot(a: Vector, b: Vector) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def cross(a: Vector, b: Vector) -> Vector:
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def length(a: Vector) -> float:
    """Euclidean length."""
    return sqrt(dot(a, a))


@kernel
def unit(a: Vector) -> Vector:
    """A divided by its length; zero stays zero."""
    size = length(a)
    return scaled(a, 1.0 / size) if size > 0.0 else a
