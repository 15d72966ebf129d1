"""What lies between a policy and a robot: latency, noise and quantisation of commands and of sensors."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.errors import listing
from softsim_core.values import FieldError


@dataclass(frozen=True, slots=True, kw_only=True)
class Devices:
    """Servos and sensors as they are; zeros are perfect ones.

    Joint quantities are in [rad], of sliding joints and cables in [m].

    Attributes:
        command_latency: From an action to the servo in [s], rounded to whole actions.
        command_noise: Standard deviation of where a servo goes.
        command_step: Smallest step of a command.
        sensor_latency: From the robot to the observation in [s], rounded to whole actions.
        joint_noise: Standard deviation of measured joint positions.
        joint_step: Smallest step of them.
        position_noise: Standard deviation of measured positions in [m], of the effector and of objects.
        tilt_noise: Of the effector's measured tilts in [rad].
        rate_noise: Of a gyroscope in [rad/s].
        force_noise: Of an accelerometer in [m/s^2].
        effort_noise: Of measured joint efforts in [N m] or [N].
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
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not 0.0 <= value < math.inf:
                raise FieldError("devices", field.name, value, ">= 0")

    def changed(self, values: Mapping[str, float]) -> Devices:
        """The same with other values by name.

        Raises:
            FieldError: no such field, or a value that is not >= 0.
        """
        known = [field.name for field in dataclasses.fields(self)]
        for name in values:
            if name not in known:
                raise FieldError("devices", name, "there", f"one of {listing(known)}")
        return dataclasses.replace(self, **{name: float(value) for name, value in values.items()})


class Delay:
    """Rows that come out some calls after they went in; of each copy its own number of calls.

    Args:
        copies, width: Shape of what goes through.
    """

    def __init__(self, copies: int, width: int) -> None:
        self._calls = np.zeros(copies, dtype=np.int64)
        self._rows = np.zeros((1, copies, width))

    def begin(self, copy: int, calls: int, row: Array) -> None:
        """Begin anew for a copy: so many calls, in which `row` (w,) comes out."""
        if calls >= len(self._rows):
            grown = np.zeros((calls + 1, *self._rows.shape[1:]))
            grown[-len(self._rows) :] = self._rows
            self._rows = grown
        self._calls[copy] = calls
        self._rows[:, copy] = row

    def through(self, copies: IndexArray, rows: Array) -> Array:
        """Put rows (k, w) of copies (k,) in; what comes out, same shape."""
        self._rows[:-1, copies] = self._rows[1:, copies]
        self._rows[-1, copies] = rows
        return np.asarray(self._rows[len(self._rows) - 1 - self._calls[copies], copies])


def rounded(values: Array, steps: Array) -> Array:
    """Values to whole steps; 0 leaves them."""
    safe = np.where(steps > 0.0, steps, 1.0)
    return np.where(steps > 0.0, np.round(values / safe) * safe, values)
