r"""Closed loop on two tilt angles: proportional-integral control with anti-windup, and its log.

A rotation is written

    R = Rx(tilt_x) Rz(turn) Ry(tilt_y).

In a frame with y up, whose axes (x, y, z) are our (y, z, x), this is Rz Ry Rx: Euler angles about fixed axes,
the first of which is tilt_y and the third tilt_x.

Per axis, each step uses the elapsed time :math:`\Delta`, reference r, measure y, output u:

    e  = r - y
    I += (ki e + ka (u_sat_previous - u_previous)) \Delta
    u  = kp e + I
    u_sat = clip(u, -saturation, saturation)

The anti-windup gain ka reduces the integral while the output is saturated. The order of operations is fixed,
so that recorded commands are reproduced to the last bit.

Source: Astrom and Murray, Feedback Systems, 2nd ed. 2021, section 11.4 (back-calculation).
"""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import NamedTuple, TextIO

import numpy as np
from numpy.typing import ArrayLike

from softsim_core.base import Array, CommandError, ConfigError, open_in_place
from softsim_core.physics.mechanics import rotation_exp

X, Y, Z = np.eye(3)


class Tilts(NamedTuple):
    """Tilts about x and y and the turn about the plate's normal, all in [rad]."""

    x: float
    y: float
    turn: float


def tilt_rotation(tilt_x: float, tilt_y: float, turn: float = 0.0) -> Array:
    """Return the rotation matrix Rx(tilt_x) Rz(turn) Ry(tilt_y), shape (3, 3); angles in [rad]."""
    return np.asarray(rotation_exp(tilt_x * X) @ rotation_exp(turn * Z) @ rotation_exp(tilt_y * Y))


def tilts_of(rotation: Array) -> Tilts:
    """Return the tilts of a rotation matrix (3, 3): tilt_x and tilt_y in (-pi, pi], turn in [-pi/2, pi/2]."""
    return Tilts(
        x=math.atan2(rotation[2, 1], rotation[1, 1]),
        y=math.atan2(rotation[0, 2], rotation[0, 0]),
        turn=math.asin(min(max(-rotation[0, 1], -1.0), 1.0)),
    )


COLUMNS = ("time", "x_reference", "x_command", "x_measure", "z_reference", "z_command", "z_measure")
"""Columns of the log in a frame with y up: x is our y (tilt_y), z is our x (tilt_x)."""


@dataclass(frozen=True, slots=True)
class TiltGains:
    """Gains of the closed loop on tilts (`TiltController`).

    Attributes:
        proportional: kp in [-], >= 0.
        integral: ki in [1/s], >= 0.
        anti_windup: ka in [1/s], >= 0.
        saturation: Largest command in [rad], > 0.

    Raises:
        CommandError: a value lies outside its interval.
    """

    proportional: float = 0.6
    integral: float = 3.5
    anti_windup: float = 0.98
    saturation: float = 0.7

    def __post_init__(self) -> None:
        for name in ("proportional", "integral", "anti_windup"):
            if not 0.0 <= getattr(self, name) < math.inf:  # also rejects NaN
                raise CommandError(f"gain {name} must be >= 0 and finite, not {getattr(self, name)}")
        if not 0.0 < self.saturation < math.inf:
            raise CommandError(f"saturation must be > 0 rad and finite, not {self.saturation}")


class TiltController:
    """Closed loop on two tilts; stores an integral and the last output per axis.

    Args:
        gains: May be replaced at any time; the integral is preserved.
    """

    def __init__(self, gains: TiltGains | None = None) -> None:
        self.gains = gains or TiltGains()
        self.reset()

    def reset(self) -> None:
        """Clear the integral and the last command."""
        self._integral = np.zeros(2)
        self._output = np.zeros(2)
        self._saturated = np.zeros(2)

    @property
    def command(self) -> Array:
        """The last command in [rad], shape (2,); zeros before the first update."""
        return self._saturated.copy()

    @property
    def is_saturated(self) -> bool:
        """Whether the last update requested more than the saturation on an axis."""
        return bool((self._output != self._saturated).any())

    def update(self, reference: ArrayLike, measure: ArrayLike, elapsed: float) -> Array:
        """Advance the loop by one step and return its command.

        Args:
            reference: Reference tilts in [rad], shape (2,).
            measure: Measured tilts in [rad], shape (2,).
            elapsed: Time since the last step in [s], >= 0.

        Returns:
            Command in [rad], shape (2,), within the saturation.

        Raises:
            CommandError: a value is not finite or of the wrong shape; the loop's state is not changed.
        """
        gains, (r, y) = self.gains, (_pair("reference", reference), _pair("measure", measure))
        if not 0.0 <= elapsed < math.inf:
            raise CommandError(f"elapsed time must be >= 0 s and finite, not {elapsed}; nothing was changed")
        e = r - y
        self._integral += (
            gains.integral * e + gains.anti_windup * (self._saturated - self._output)
        ) * elapsed
        self._output = gains.proportional * e + self._integral
        self._saturated = np.clip(self._output, -gains.saturation, gains.saturation)
        return self.command


@dataclass(frozen=True, slots=True, eq=False)
class ClosedLoopRecord:
    """A log as arrays. The first column of a pair is the log's x axis, the second its z axis.

    Attributes:
        time: Sum of the elapsed times in [s], shape (n,).
        reference, command, measure: Tilts in [rad], shape (n, 2).
    """

    time: Array
    reference: Array
    command: Array
    measure: Array

    @property
    def elapsed(self) -> Array:
        """Elapsed time of each step in [s], shape (n,); the first step started at time 0."""
        return np.diff(self.time, prepend=0.0)


class ClosedLoopLog:
    """Writer of a closed loop's log: comma separated values, one row per step, full precision, CR LF.

    Args:
        file: Path of the file; an existing file is replaced.

    Raises:
        ConfigError: the file cannot be written.
    """

    def __init__(self, file: str | PathLike[str]) -> None:
        self.file = Path(file)
        try:
            self._stream: TextIO = open_in_place(self.file, "w", newline="")
        except OSError as error:
            raise ConfigError(
                self.file, "", f"cannot be written: {error.strerror}; name another file"
            ) from error
        self._writer = csv.writer(self._stream)
        self._writer.writerow(COLUMNS)

    def write(
        self,
        time: float,
        reference: Sequence[float] | Array,
        command: Sequence[float] | Array,
        measure: Sequence[float] | Array,
    ) -> None:
        """Append one row: time in [s], then (x, z) tilts in [rad] of the log's axes."""
        pairs = zip(reference, command, measure, strict=True)
        self._writer.writerow([float(time), *(float(value) for triple in pairs for value in triple)])

    def flush(self) -> None:
        """Flush written rows to the operating system."""
        self._stream.flush()

    def close(self) -> None:
        """Write the remaining rows and close the file; a second call does nothing."""
        self._stream.close()

    def __enter__(self) -> ClosedLoopLog:
        """Return the log itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the file."""
        self.close()


def read_closed_loop_log(file: str | PathLike[str]) -> ClosedLoopRecord:
    """Read a log written by `ClosedLoopLog`.

    Raises:
        ConfigError: no such file, other columns, or a row that does not contain seven finite numbers.
    """
    name = fspath(file)
    try:
        with Path(file).open(newline="") as stream:
            rows = list(csv.reader(stream))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(name, "", f"cannot be read as comma separated values: {error}") from error
    if not rows or tuple(rows[0]) != COLUMNS:
        raise ConfigError(name, "row 1", f"the columns must be {','.join(COLUMNS)}")
    table = np.empty((len(rows) - 1, len(COLUMNS)))
    for number, row in enumerate(rows[1:], start=2):
        try:
            table[number - 2] = [float(text) for text in row]
        except ValueError as error:
            raise ConfigError(name, f"row {number}", f"needs {len(COLUMNS)} numbers") from error
        if not np.isfinite(table[number - 2]).all():
            raise ConfigError(name, f"row {number}", "every number must be finite")
    return ClosedLoopRecord(table[:, 0], table[:, [1, 4]], table[:, [2, 5]], table[:, [3, 6]])


def _pair(name: str, values: ArrayLike) -> Array:
    pair = np.asarray(values, dtype=np.float64)
    if pair.shape != (2,) or not np.isfinite(pair).all():
        raise CommandError(
            f"{name} must be two finite angles in rad, not {pair.tolist()}; nothing was changed"
        )
    return pair
