"""The interface of sensors: their frame, the step's results that they read, and reproducible noise.

A counter-based generator (Philox) takes its key from a sensor's seed and name, and its counter from the
sample's number. So noise depends on no other sensor, repeats after a reset, and continues in the same way
from a snapshot, without any state of its own.

Source: Salmon et al. 2011, Parallel random numbers: as easy as 1, 2, 3.
"""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from softsim_core.base import Array, Placement
from softsim_core.physics.dynamics import ContactReport, StepReport
from softsim_core.physics.mechanics import Carrier, Model, State, rotation_euler


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """A frame in a carrier.

    Attributes:
        carrier: The carrier of the frame.
        position: Its origin in the carrier's frame in [m], shape (3,).
        rotation: Its rotation in the carrier's frame, shape (3, 3).
    """

    carrier: Carrier
    position: Array = field(default_factory=lambda: np.zeros(3))
    rotation: Array = field(default_factory=lambda: np.eye(3))

    def within(self, placement: Placement) -> Place:
        """Return the frame at a placement in this one (its scale is not used)."""
        shift = np.array(placement.translation, dtype=float)
        turn = rotation_euler(np.radians(placement.rotation_deg))
        return Place(self.carrier, self.position + self.rotation @ shift, self.rotation @ turn)

    def pose(self, model: Model, state: State) -> tuple[Array, Array]:
        """Return the origin (3,) in [m] and the rotation (3, 3) in the world."""
        origin, rotation = self.carrier.pose(model, state)
        return origin + rotation @ self.position, rotation @ self.rotation

    def twist(self, model: Model, state: State) -> tuple[Array, Array]:
        """Return the velocity (3,) of the origin in [m/s] and the spin (3,) in [rad/s], world axes."""
        return self.carrier.twist(model, state, self.pose(model, state)[0])


class SampleNoise:
    """The random numbers of one sensor.

    Args:
        seed: Its seed.
        name: Its name.
    """

    def __init__(self, seed: int, name: str) -> None:
        key = np.frombuffer(hashlib.sha256(f"{seed} {name}".encode()).digest()[:16], dtype="<u8")
        self._bits = np.random.Philox(key=key)
        self._generator = np.random.Generator(self._bits)
        self._state = self._bits.state

    def of_sample(self, number: int) -> np.random.Generator:
        """Return the generator at the start of a sample's draws; each call sets it back there."""
        self._state["state"]["counter"][3] = number  # counts up from the other end
        self._bits.state = self._state
        return self._generator


@dataclass(frozen=True, slots=True, eq=False)
class StepObservation:
    """Inputs of the sensors at the end of a step.

    Attributes:
        model: The model.
        before: The state at the start of the step; before the first step, `state`.
        state: The current state.
        report: The step's report.
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
        """The contacts of the step."""
        return self.report.contacts


class Sensor(ABC):
    """A sensor: its measurement, noise and bias.

    Args:
        noise: Standard deviations of the measured values, in their units, of a shape that fits them.
        bias: Bias of the measured values, likewise.
    """

    def __init__(self, noise: ArrayLike = 0.0, bias: ArrayLike = 0.0) -> None:
        self.noise, self.bias = np.asarray(noise, dtype=float), np.asarray(bias, dtype=float)

    @property
    def random(self) -> bool:
        """Whether `add_noise` draws from its generator."""
        return bool(self.noise.any())

    @abstractmethod
    def measure(self, observation: StepObservation) -> Array:
        """Return the true value, always of the same shape."""

    def add_noise(self, value: Array, generator: np.random.Generator | None) -> Array:
        """Return the sample for a true `value`; without a generator nothing is random."""
        sample = value + self.bias
        if generator is not None:
            sample = sample + self.noise * generator.standard_normal(value.shape)
        return np.asarray(sample)
