"""Registers in compiled code: each operator and function lane by lane, beside NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("numba")
pytestmark = pytest.mark.numba

from numba import njit  # noqa: E402

from softsim_core.physics.linalg import (  # noqa: E402
    LANES,
    bits_of,
    gather,
    put,
    put_quads,
    root,
    row,
    subtract_at,
    where,
)

RNG = np.random.default_rng(3)
A, B = RNG.normal(size=(2, 1, LANES))
A[0, 0], B[0, 1], A[0, 2] = np.nan, np.inf, B[0, 2]
TWO: Any = np.concatenate([A, B])


@njit
def calculate(x: Any, out: Any) -> None:
    """All operators of two registers, and of a register and a number on either side."""
    a, b = row(x, 0), row(x, 1)
    put(out, 0, a + b)
    put(out, 1, a - b)
    put(out, 2, a * b)
    put(out, 3, a / b)
    put(out, 4, -a)
    put(out, 5, 2.0 * a - 1)
    put(out, 6, 1.0 / (b + 3.0))
    put(out, 7, root(a * a))


def test_arithmetic_is_that_of_each_lane() -> None:
    out = np.empty((8, LANES))
    calculate(TWO, out)
    a, b = TWO
    expected = [a + b, a - b, a * b, a / b, -a, 2.0 * a - 1.0, 1.0 / (b + 3.0), abs(a)]
    np.testing.assert_allclose(out, expected, rtol=1e-15)


@njit
def compare(x: Any, out: Any) -> None:
    """All comparisons, as 1 and 0, and masks of masks."""
    a, b = row(x, 0), row(x, 1)
    put(out, 0, where(a < b, 1.0, 0.0))
    put(out, 1, where(a <= b, 1.0, 0.0))
    put(out, 2, where(a > b, 1.0, 0.0))
    put(out, 3, where(a >= b, 1.0, 0.0))
    put(out, 4, where(a == b, 1.0, 0.0))
    put(out, 5, where(~(a >= b), a, b))
    put(out, 6, where((a < 0.0) | (b > 0.0), 1.0, 0.0))
    put(out, 7, where((a < 0.0) & (b > 0.0), 1.0, 0.0))
    out[8, 0] = bits_of(a < 0.0)


def test_comparisons_with_nan_are_false() -> None:
    out = np.zeros((9, LANES))
    compare(TWO, out)
    a, b = TWO
    expected = [a < b, a <= b, a > b, a >= b, a == b, np.where(~(a >= b), a, b)]
    np.testing.assert_array_equal(out[:6], expected)
    np.testing.assert_array_equal(out[6:8], [(a < 0) | (b > 0), (a < 0) & (b > 0)])
    assert out[8, 0] == sum(1 << lane for lane in range(LANES) if a[lane] < 0)


@njit
def spread(values: Any, nodes: Any, sums: Any, quads: Any) -> None:
    """Gather rows by the second row of `nodes`, subtract them elsewhere, and write them lane by lane."""
    triple = gather(values, nodes, 1)
    subtract_at(sums, nodes, 1, triple)
    put_quads(quads, 4, triple)


def test_rows_are_gathered_and_repeated_nodes_get_each_share() -> None:
    values, nodes = RNG.normal(size=(5, 3)), RNG.integers(0, 5, (2, LANES))
    nodes[1, 0] = 4  # the last row: nothing is read beyond the array
    sums, quads = np.zeros((5, 4)), np.full((8, LANES), 7.0)
    spread(values, nodes, sums, quads)
    expected = np.zeros((5, 4))
    np.subtract.at(expected[:, :3], nodes[1], values[nodes[1]])
    np.testing.assert_allclose(sums, expected, rtol=1e-15)
    np.testing.assert_array_equal(quads[:4], 7.0)
    of_lanes = quads[4:].reshape(LANES, 4)
    np.testing.assert_array_equal(of_lanes, np.column_stack([values[nodes[1]], np.zeros(LANES)]))
