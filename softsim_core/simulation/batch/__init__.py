"""Many copies of a scene at once: one model and one plan; each has its state, commands and parameters."""

from __future__ import annotations

from softsim_core.simulation.batch.batch import Batch

__all__ = ["Batch"]
