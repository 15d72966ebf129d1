"""A curve of stress over stretch in the characters of a terminal."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softsim_core.arrays import Array

WIDTH, HEIGHT = 60, 16
"""Characters across and lines of the chart."""


class Curve(NamedTuple):
    """A law's curve of tension and measured points.

    Attributes:
        title: What it is.
        stretches: In [-], rising, shape (k,).
        stresses: Nominal, in [Pa], shape (k,).
        points: Measured stretch in [-] and stress in [Pa], shape (j, 2).
    """

    title: str
    stretches: Array
    stresses: Array
    points: Array


def terminal_chart(curve: Curve) -> list[str]:
    """Lines of the chart: the law in dots, points as o."""
    highest = float(max(curve.stresses.max(), curve.points[:, 1].max(initial=0.0)))
    first, last = float(curve.stretches[0]), float(curve.stretches[-1])
    cells = [[" "] * WIDTH for _ in range(HEIGHT)]

    def put(stretch: float, stress: float, mark: str) -> None:
        column = round((stretch - first) / (last - first) * (WIDTH - 1))
        row = round((1.0 - stress / highest) * (HEIGHT - 1))
        cells[min(max(row, 0), HEIGHT - 1)][min(max(column, 0), WIDTH - 1)] = mark

    for stretch in np.linspace(first, last, WIDTH).tolist():
        put(stretch, float(np.interp(stretch, curve.stretches, curve.stresses)), ".")
    for stretch, stress in curve.points.tolist():
        put(stretch, stress, "o")
    top, foot = f"{1e-3 * highest:.4g}", f"{first:g}"
    margin = len(top)
    labels = [top, *[""] * (HEIGHT - 2), "0"]
    lines = [f"{label:>{margin}} |{''.join(row)}".rstrip() for label, row in zip(labels, cells, strict=True)]
    axis = " " * (margin + 2) + foot + f"{last:g}".rjust(WIDTH - len(foot))
    return [
        f"nominal stress in kPa over stretch: . {curve.title}, o measured",
        *lines,
        " " * margin + " +" + "-" * WIDTH,
        axis,
    ]
