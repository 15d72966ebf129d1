"""The time step and statics: implementations of the step behind one interface."""

from __future__ import annotations

from typing import Literal, TypeAlias

Backend: TypeAlias = Literal["auto", "numba", "scipy"]
"""Implementation of the step: compiled, in plain NumPy and SciPy, or the first of them that is installed."""
