"""The seam of sensors: what one sees of a step, and what it makes of it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from softsim_core.arrays import Array
from softsim_core.dynamics.report import ContactReport, StepReport
from softsim_core.mechanics.model import Model
from softsim_core.mechanics.state import State


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What sensors see at the end of a step.

    Attributes:
        model: The model.
        before: The state at the start of the step; where none was done it is `state`.
        state: The state now.
        report: What the step told.
        forces: External forces on the nodes in the step in [N], shape (n, 3).
        drag: Damping per mass in the step in [1/s].
    """

    model: Model
    before: State
    state: State
    report: StepReport
    forces: Array
    drag: float = 0.0

    @property
    def contacts(self) -> ContactReport:
        """What touched in the step."""
        return self.report.contacts


class Sensor(ABC):
    """What one sensor measures.

    Args:
        noise: Standard deviations of what it measures, in its units, of a shape that fits it.
        bias: What it measures too much, likewise.
    """

    def __init__(self, noise: ArrayLike = 0.0, bias: ArrayLike = 0.0) -> None:
        self.noise, self.bias = np.asarray(noise, dtype=float), np.asarray(bias, dtype=float)

    @property
    def random(self) -> bool:
        """Whether `disturbed` draws from its generator."""
        return bool(self.noise.any())

    @abstractmethod
    def measure(self, seen: Seen) -> Array:
        """The true value, of a shape that is always the same."""

    def disturbed(self, value: Array, generator: np.random.Generator | None) -> Array:
        """What it tells where `value` is true; without a generator nothing is random."""
        told = value + self.bias
        if generator is not None:
            told = told + self.noise * generator.standard_normal(value.shape)
        return np.asarray(told)
