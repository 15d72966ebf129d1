"""What this processor can do: a fixed kernel that streams numbers and multiplies them, as a step does.

A target that compares a step with SuperLU depends on the processor, since SuperLU follows indices where the
step works on dense panels. The probe does nothing but the latter two, so that a step that misses both targets
has become slower, and not the machine.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from softsim_core.base import Array

_PANELS, _ROWS, _COLUMNS = 64, 64, 32
"""Panels of 16 kB in all 1 MB, such as the factor of a mesh of a thousand nodes."""


class Probe:
    """The work of the probe: each of many dense panels times itself.

    Attributes:
        panels: The panels, shape (p, r, c).
        squares: The products, shape (p, c, c).
    """

    def __init__(self) -> None:
        import numba

        self.panels = np.random.default_rng(1).uniform(0.5, 1.0, (_PANELS, _ROWS, _COLUMNS))
        self.squares = np.zeros((_PANELS, _COLUMNS, _COLUMNS))
        self._update: Any = numba.njit(fastmath=True, error_model="numpy")(_update)

    def run(self) -> None:
        """Do the work once: 8.4 Mflop, and 1.5 MB read or written."""
        self._update(self.panels, self.squares)


def _update(panels: Array, squares: Array) -> None:
    """Set each square to the product of its panel with itself, row by row."""
    for p in range(len(panels)):
        panel, square = panels[p], squares[p]
        square[:] = 0.0
        for row in range(panel.shape[0]):
            for i in range(panel.shape[1]):
                factor = panel[row, i]
                for j in range(panel.shape[1]):
                    square[i, j] += factor * panel[row, j]
