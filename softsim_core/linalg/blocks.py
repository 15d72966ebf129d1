"""Factoring wide panels in blocks of rows that stay in the cache.

A block of rows is factored, copied into strips of columns, and what it takes off all that comes later is
computed strip by strip: of each pair of strips, both lie in the cache side by side. Panels that fit in the
cache as they are need none of that, see cholesky.factor.

Source: Goto and van de Geijn 2008, Anatomy of high-performance matrix multiplication.
"""

from __future__ import annotations

from softsim_core.arrays import Array
from softsim_core.linalg.compile import kernel
from softsim_core.linalg.simd import LANES, ROWS, tile_one, tile_two

BLOCK = 128
"""Rows of a block."""

STRIP = 2 * LANES
"""Columns of a strip; ROWS divides it."""

FITS = 1 << 15
"""Panels of at most so many numbers are factored without blocks: 256 kB."""


@kernel
def copy_strips(
    panels: Array, start: int, width: int, count: int, length: int, strips: Array, goal: int
) -> None:
    """`count` rows of `length` numbers, `width` apart, as strips one after another: row by row in each."""
    for first in range(0, length, STRIP):
        many, place = min(STRIP, length - first), goal + first * count
        for k in range(count):
            row = start + k * width + first
            for i in range(many):
                strips[place + i] = panels[row + i]
            for i in range(many, STRIP):
                strips[place + i] = 0.0
            place += STRIP


@kernel
def subtract_strips(
    target: Array, place: int, stride: int, rows: int, strips: Array, left: int, first: int, right: int,
    length: int, count: int, upper: bool,
) -> None:  # fmt: skip
    """target[i, j] -= the product of columns first + i and j of strips, over the `count` rows they hold.

    The target has rows i < `rows` of `length` numbers from `place` on; `rows` is rounded up to a multiple of
    ROWS. The strips with the columns of i begin at `left`, those with the columns of j at `right`. With
    `upper`, i and j count alike, and only j >= i is wanted.
    """
    group = 0
    while group < rows:
        end = min(rows, group + STRIP - (first + group) % STRIP)
        for j in range(group - group % STRIP if upper else 0, length, STRIP):
            b = right + j * count
            for i in range(group, end, ROWS):
                a = left + (first + i) // STRIP * STRIP * count + (first + i) % STRIP
                if j + STRIP <= length:
                    tile_two(target, place + i * stride + j, stride, strips, a, b, STRIP, count)
                else:
                    tile_one(target, place + i * stride + j, stride, strips, a, b, STRIP, count)
        group = end


@kernel
def strips_length(width: int) -> int:
    """Numbers that the strips of a block take, of panels so wide."""
    return BLOCK * (width + 2 * STRIP)


@kernel
def subtract_block(
    panels: Array, begin: int, width: int, low: int, high: int, rows: int, later: int, side: int,
    stack: Array, top: int, strips: Array,
) -> None:  # fmt: skip
    """What panel rows low .. high take off the later rows of the panel, up to `rows`, and its update.

    The update lies in `stack` from `top`, in `side` rows of width - later numbers.
    """
    count, pitch, own = high - low, width - later, later - high
    beyond = (own + STRIP - 1) // STRIP * STRIP * count
    line = begin + low * width
    copy_strips(panels, line + high, width, count, own, strips, 0)
    copy_strips(panels, line + later, width, count, pitch, strips, beyond)
    place, left = begin + high * width, rows - high
    subtract_strips(panels, place + high, width, left, strips, 0, 0, 0, own, count, True)
    subtract_strips(panels, place + later, width, left, strips, 0, 0, beyond, pitch, count, False)
    subtract_strips(stack, top, pitch, side, strips, beyond, 0, beyond, pitch, count, True)
