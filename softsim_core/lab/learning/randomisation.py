"""Distributions of scene values, and devices between policy and robot: latency, noise, quantisation."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from softsim_core.base import Array, ConfigError, FieldError, IndexArray, listing
from softsim_core.lab.identification import DistributionDescription, load_distribution, replace_expressions
from softsim_core.scene.io import laid_over, read_extended, structure_description


@dataclass(frozen=True, slots=True, kw_only=True)
class Devices:
    """Errors of servos and sensors; zeros are perfect devices.

    Joint quantities are in [rad], for sliding joints and cables in [m].

    Attributes:
        command_latency: From an action to the servo in [s], rounded to whole actions.
        command_noise: Standard deviation of servo positions.
        command_step: Resolution of a command.
        sensor_latency: From the robot to the observation in [s], rounded to whole actions.
        joint_noise: Standard deviation of measured joint positions.
        joint_step: Resolution of measured joint positions.
        position_noise: Standard deviation of measured positions in [m], of the effector and of objects.
        tilt_noise: Standard deviation of the effector's measured tilts in [rad].
        rate_noise: Standard deviation of a gyroscope in [rad/s].
        force_noise: Standard deviation of an accelerometer in [m/s^2].
        effort_noise: Standard deviation of measured joint efforts in [N m] or [N].
    """

    command_latency: float = 0.0
    command_noise: float = 0.0
    command_step: float = 0.0
    sensor_latency: float = 0.0
    joint_noise: float = 0.0
    joint_step: float = 0.0
    position_noise: float = 0.0
    tilt_noise: float = 0.0
    rate_noise: float = 0.0
    force_noise: float = 0.0
    effort_noise: float = 0.0

    def __post_init__(self) -> None:
        for each in dataclasses.fields(self):
            value = getattr(self, each.name)
            if not 0.0 <= value < math.inf:
                raise FieldError("devices", each.name, value, ">= 0")

    def with_values(self, values: Mapping[str, float]) -> Devices:
        """Return a copy with other values by name.

        Raises:
            FieldError: no such field, or a value that is not >= 0.
        """
        names = [field.name for field in dataclasses.fields(self)]
        for name in values:
            if name not in names:
                raise FieldError("devices", name, "there", f"one of {listing(names)}")
        return dataclasses.replace(self, **{name: float(value) for name, value in values.items()})


class Delay:
    """Delay line of rows (copies, width); each copy has its own delay, counted in calls."""

    def __init__(self, copies: int, width: int) -> None:
        self._calls = np.zeros(copies, dtype=np.int64)
        self._rows = np.zeros((1, copies, width))

    def begin(self, copy: int, calls: int, row: Array) -> None:
        """Restart the delay of a copy: during `calls` calls it returns `row` (w,)."""
        if calls >= len(self._rows):
            grown = np.zeros((calls + 1, *self._rows.shape[1:]))
            grown[-len(self._rows) :] = self._rows
            self._rows = grown
        self._calls[copy] = calls
        self._rows[:, copy] = row

    def through(self, copies: IndexArray, rows: Array) -> Array:
        """Insert rows (k, w) of copies (k,) and return the delayed rows, of the same shape."""
        self._rows[:-1, copies] = self._rows[1:, copies]
        self._rows[-1, copies] = rows
        return np.asarray(self._rows[len(self._rows) - 1 - self._calls[copies], copies])


def round_to_steps(values: Array, steps: Array) -> Array:
    """Round values to multiples of the steps; a step of 0 leaves them unchanged."""
    safe = np.where(steps > 0.0, steps, 1.0)
    return np.where(steps > 0.0, np.round(values / safe) * safe, values)


@dataclass(frozen=True, slots=True, kw_only=True)
class SpreadDescription:
    """Distribution of a parameter: exactly one of the first three.

    Attributes:
        uniform: Uniform between two values.
        log_uniform: Uniform in its logarithm between two values > 0.
        normal: Mean and standard deviation.
        bounds: Values outside are drawn again.
    """

    uniform: tuple[float, float] | None = None
    log_uniform: tuple[float, float] | None = None
    normal: tuple[float, float] | None = None
    bounds: tuple[float, float] = (-math.inf, math.inf)

    def __post_init__(self) -> None:
        owner = "a parameter"
        spreads = [each for each in (self.uniform, self.log_uniform, self.normal) if each is not None]
        if len(spreads) != 1:
            raise FieldError(owner, "uniform", f"{len(spreads)} given", "one of uniform, log_uniform, normal")
        for name, pair in (("uniform", self.uniform), ("log_uniform", self.log_uniform)):
            if pair is not None and not pair[0] <= pair[1]:
                raise FieldError(owner, name, pair, "two values, the lower one first")
        if self.log_uniform is not None and not self.log_uniform[0] > 0.0:
            raise FieldError(owner, "log_uniform", self.log_uniform, "> 0")
        if self.normal is not None and not self.normal[1] >= 0.0:
            raise FieldError(owner, "normal", self.normal, "a mean and a standard deviation >= 0")
        if not self.bounds[0] < self.bounds[1]:
            raise FieldError(owner, "bounds", self.bounds, "two values, the lower one first")

    def draw(self, random: np.random.Generator) -> float:
        """Draw one value.

        Raises:
            FieldError: none of a thousand lies within the bounds.
        """
        for _ in range(1000):
            if self.uniform is not None:
                value = random.uniform(*self.uniform)
            elif self.log_uniform is not None:
                low, high = self.log_uniform
                value = math.exp(random.uniform(math.log(low), math.log(high)))
            else:
                assert self.normal is not None  # checked at the start
                value = random.normal(*self.normal)
            if self.bounds[0] <= value <= self.bounds[1]:
                return float(value)
        raise FieldError("a parameter", "bounds", self.bounds, "such that values fall into them")


@dataclass(frozen=True, slots=True, kw_only=True)
class RandomisationDescription:
    """Variations from episode to episode.

    Attributes:
        name: Name in messages.
        parameters: Parameters by name.
        posterior: A distribution that `softsim calibrate` wrote; its overlay is applied to the robot first,
            and its parameters may be used in the other fields.
        scene: Overrides of the robot: values of the scene, or expressions of the parameters (`= 2 *
            modulus`).
        devices: Fields of Devices: values, or such expressions.
    """

    name: str = "randomisation"
    parameters: dict[str, SpreadDescription] = field(default_factory=dict)
    posterior: Path | None = None
    scene: dict[str, Any] = field(default_factory=dict)
    devices: dict[str, Any] = field(default_factory=dict)


class Randomisation:
    """Sampler of a description and of the distribution that it names."""

    def __init__(
        self, description: RandomisationDescription, posterior: DistributionDescription | None = None
    ) -> None:
        self._description, self._posterior = description, posterior

    def draw(self, random: np.random.Generator) -> tuple[dict[str, Any], dict[str, float], dict[str, float]]:
        """Draw the overlay of the robot, fields of Devices, and the parameters of one episode.

        Raises:
            SceneError: an expression with an unknown name, or bounds that no value satisfies.
        """
        description, values, overlay = self._description, dict[str, float](), dict[str, Any]()
        if self._posterior is not None:
            drawn = self._posterior.draw(1, int(random.integers(1 << 62)))[0]
            values |= dict(zip(self._posterior.names, drawn.tolist(), strict=True))
            overlay = self._posterior.fill_overlay(drawn)
        values |= {name: spread.draw(random) for name, spread in description.parameters.items()}
        devices = {
            name: float(value) for name, value in replace_expressions(description.devices, values).items()
        }
        return laid_over(overlay, replace_expressions(description.scene, values)), devices, values


def load_randomisation(file: str | Path) -> Randomisation:
    """Load a randomisation from its file, or from a distribution that `softsim calibrate` wrote.

    Raises:
        ConfigError: the file does not exist, or any problem in it, as one message.
    """
    path = Path(file).expanduser().absolute()
    if not path.is_file():
        raise ConfigError(str(file), "", "no such file")
    data = read_extended(path)
    if isinstance(data, Mapping) and "covariance" in data:
        return Randomisation(RandomisationDescription(), load_distribution(path))
    description = structure_description(data, RandomisationDescription, path, find_files=False)
    posterior = description.posterior
    return Randomisation(
        description, None if posterior is None else load_distribution(path.parent / posterior)
    )
