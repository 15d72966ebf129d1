"""Vectors and matrices of three as compiled parts: triples of registers or numbers, and triples of rows."""

from __future__ import annotations

from typing import Any

from softsim_core.base import Array
from softsim_core.physics.linalg import part, put, root, row, where

Triple = tuple[Any, Any, Any]
Matrix = tuple[Triple, Triple, Triple]


@part
def dot(a: Triple, b: Triple) -> Any:
    """Return a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@part
def cross(a: Triple, b: Triple) -> Triple:
    """Return a x b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@part
def scaled(factor: Any, a: Triple) -> Triple:
    """Return a times a factor."""
    return (factor * a[0], factor * a[1], factor * a[2])


@part
def plus(a: Triple, b: Triple) -> Triple:
    """Return a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@part
def minus(a: Triple, b: Triple) -> Triple:
    """Return a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@part
def product(a: Triple, b: Triple) -> Triple:
    """Return a times b, component by component."""
    return (a[0] * b[0], a[1] * b[1], a[2] * b[2])


@part
def over(a: Triple, divisor: Any) -> Triple:
    """Return a by a divisor."""
    return (a[0] / divisor, a[1] / divisor, a[2] / divisor)


@part
def unit(a: Triple) -> Triple:
    """Return the direction of a."""
    return over(a, root(dot(a, a)))


@part
def choose(mask: Any, a: Triple, b: Triple) -> Triple:
    """Return a where the mask is set, else b."""
    return (where(mask, a[0], b[0]), where(mask, a[1], b[1]), where(mask, a[2], b[2]))


@part
def times(m: Matrix, a: Triple) -> Triple:
    """Return matrix times vector."""
    return (dot(m[0], a), dot(m[1], a), dot(m[2], a))


@part
def transposed(m: Matrix) -> Matrix:
    """Return the transposed matrix."""
    return (
        (m[0][0], m[1][0], m[2][0]),
        (m[0][1], m[1][1], m[2][1]),
        (m[0][2], m[1][2], m[2][2]),
    )


@part
def difference(m: Matrix, n: Matrix) -> Matrix:
    """Return the difference of two matrices."""
    return (minus(m[0], n[0]), minus(m[1], n[1]), minus(m[2], n[2]))


@part
def cofactors(m: Matrix) -> Matrix:
    """Return the cofactors of a matrix."""
    return (cross(m[1], m[2]), cross(m[2], m[0]), cross(m[0], m[1]))


@part
def contraction(m: Matrix, n: Matrix) -> Any:
    """Return M : N."""
    return dot(m[0], n[0]) + dot(m[1], n[1]) + dot(m[2], n[2])


@part
def at_least(a: Any, floor: Any) -> Any:
    """Return the larger of two numbers; the second one where the first is NaN."""
    return where(a >= floor, a, floor)


@part
def positive(a: Any) -> Any:
    """Return a number, or 0 where it is negative; NaN stays NaN."""
    return where(a < 0.0, 0.0, a)


@part
def size(a: Any) -> Any:
    """Return the absolute value."""
    return where(a < 0.0, -a, a)


@part
def triple_at(array: Array, index: int) -> Triple:
    """Return three rows of an array of registers."""
    return (row(array, index), row(array, index + 1), row(array, index + 2))


@part
def matrix_at(array: Array, index: int) -> Matrix:
    """Return nine rows of an array of registers as a matrix."""
    return (triple_at(array, index), triple_at(array, index + 3), triple_at(array, index + 6))


@part
def put_triple(array: Array, index: int, a: Triple) -> None:
    """Write three rows of an array of registers."""
    put(array, index, a[0])
    put(array, index + 1, a[1])
    put(array, index + 2, a[2])


@part
def put_matrix(array: Array, index: int, m: Matrix) -> None:
    """Write nine rows of an array of registers."""
    put_triple(array, index, m[0])
    put_triple(array, index + 3, m[1])
    put_triple(array, index + 6, m[2])
