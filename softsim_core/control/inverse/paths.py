"""Timed paths of the effector and their files: maze plans (JSON), timed poses (CSV)."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from softsim_core.base import MILLIMETRE, Array, CommandError, ConfigError, known_names, listing, shorten
from softsim_core.control.inverse.closed_loop import tilt_rotation
from softsim_core.physics.mechanics import Pose, quaternion_of
from softsim_core.scene.io import config_roots

MAZE_SPACING_S = 0.5
"""Time between two pairs of a maze plan in [s]."""

MAZE_LIFT_M = 20.0 * MILLIMETRE
"""Rise of the plate above its start during the first interval of a maze plan, in [m]."""

MAZE_SAMPLE_S = 0.01
"""Spacing of a maze path's key poses in [s]; angles, not rotations, are linear between plan points."""

UNIT_WITHIN = 0.01
"""Largest deviation of a quaternion's length from 1; a smaller one is normalised, a larger one rejected."""


@dataclass(frozen=True, slots=True, eq=False)
class EffectorPath:
    """Key poses in time. The path is constant before the first and after the last one.

    Attributes:
        times: Seconds after the start, shape (p,), p >= 1, finite, >= 0 and strictly increasing.
        positions: Positions in [m], shape (p, 3), finite.
        quaternions: Unit quaternions (x, y, z, w), shape (p, 4), neighbours on the same half sphere.

    Raises:
        CommandError: anything else; names the first wrong row (counted from 0).
    """

    times: Array
    positions: Array
    quaternions: Array

    def __init__(self, times: ArrayLike, positions: ArrayLike, quaternions: ArrayLike) -> None:
        times, positions = _floats("times", times), _floats("positions", positions)
        quaternions = _floats("quaternions", quaternions)
        _check(times, positions, quaternions)
        quaternions = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
        turns_back = (quaternions[1:] * quaternions[:-1]).sum(axis=1) < 0.0
        quaternions[1:] *= np.where(np.cumsum(turns_back) % 2, -1.0, 1.0)[:, None]
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "quaternions", quaternions)

    @property
    def duration(self) -> float:
        """Time of the last key pose in [s]."""
        return float(self.times[-1])

    def sample(self, time: float) -> Pose:
        """Interpolate the pose at `time` in [s]: linear position, shortest rotation at constant speed."""
        at = float(np.clip(time, self.times[0], self.times[-1]))
        after = int(np.clip(np.searchsorted(self.times, at, side="right"), 1, max(len(self.times) - 1, 1)))
        if len(self.times) == 1:
            return Pose(self.positions[0].copy(), self.quaternions[0].copy())
        t0, t1 = self.times[after - 1 : after + 1]
        part = (at - t0) / (t1 - t0)
        position = (1.0 - part) * self.positions[after - 1] + part * self.positions[after]
        return Pose(position, slerp(self.quaternions[after - 1], self.quaternions[after], part))

    def is_over(self, time: float) -> bool:
        """Return whether `time` in [s] is at the last key pose or later, with a tolerance of a nanosecond."""
        return time >= self.duration - 1e-9


def slerp(first: Array, second: Array, part: float) -> Array:
    """Interpolate between unit quaternions (x, y, z, w) along the shorter rotation (Shoemake 1985)."""
    cosine = float(first @ second)
    if cosine < 0.0:
        second, cosine = -second, -cosine
    angle = np.arctan2(np.linalg.norm(second - cosine * first), cosine)
    if angle < 1e-9:
        mixed = (1.0 - part) * first + part * second
    else:
        mixed = (np.sin((1.0 - part) * angle) * first + np.sin(part * angle) * second) / np.sin(angle)
    return np.asarray(mixed / np.linalg.norm(mixed))


def maze_path(pairs: Sequence[Sequence[float]] | Array, start: ArrayLike) -> EffectorPath:
    """Return the path of a maze plan: the plate rises by 20 mm in the first half second, then tilts.

    Key points are 0.5 s apart: level at the start, then pair after pair. Angles and height are linear in time
    in between, and the path ends at the last pair.

    Args:
        pairs: Pairs of angles in [rad], shape (k, 2), k >= 1, about x and z of the plan's frame, in which y
            is up and (x, y, z) are our (y, z, x). The first angle of a pair is our tilt_y, the second our
            tilt_x: Rz(second) Rx(first) there is Rx(tilt_x) Ry(tilt_y) here.
        start: Position of the effector at the start in [m], shape (3,).

    Raises:
        CommandError: not k >= 1 pairs of finite numbers.
    """
    angles, origin = _floats("pairs", pairs), _floats("start", start)
    if angles.ndim != 2 or angles.shape[1:] != (2,) or len(angles) == 0 or origin.shape != (3,):
        raise PathRefusedError(
            "a maze plan needs one or more pairs of angles and a start (3,), "
            f"not shapes {angles.shape} and {origin.shape}"
        )
    if not (np.isfinite(angles).all() and np.isfinite(origin).all()):
        raise PathRefusedError("an angle of the maze plan, or its start, is not a finite number")
    key_times = MAZE_SPACING_S * np.arange(len(angles) + 1)
    samples = round(MAZE_SPACING_S / MAZE_SAMPLE_S) * len(angles) + 1
    times = np.linspace(0.0, key_times[-1], samples)
    padded = np.vstack([np.zeros(2), angles])
    tilt_y, tilt_x = (np.interp(times, key_times, column) for column in padded.T)
    positions = np.tile(origin, (samples, 1))
    positions[:, 2] += np.interp(times, key_times[:2], (0.0, MAZE_LIFT_M))
    turns = [quaternion_of(tilt_rotation(x, y)) for x, y in zip(tilt_x, tilt_y, strict=True)]
    return EffectorPath(times, positions, turns)


def _check(times: Array, positions: Array, quaternions: Array) -> None:
    count = len(times) if times.ndim == 1 else 0
    if count == 0:
        raise PathRefusedError("it has no poses; expected at least one time with a pose")
    if positions.shape != (count, 3) or quaternions.shape != (count, 4):
        raise PathRefusedError(
            f"positions of shape {positions.shape} and quaternions of shape {quaternions.shape} "
            f"do not fit {count} times"
        )
    for name, table in (("time", times[:, None]), ("position", positions), ("quaternion", quaternions)):
        bad = ~np.isfinite(table).all(axis=1)
        if bad.any():
            raise PathRefusedError(f"a {name} is not a finite number", int(np.argmax(bad)))
    late = np.concatenate([[times[0] < 0.0], np.diff(times) <= 0.0])
    if late.any():
        raise PathRefusedError("times must be >= 0 s and strictly increasing", int(np.argmax(late)))
    stretched = np.abs(np.linalg.norm(quaternions, axis=1) - 1.0) > UNIT_WITHIN
    if stretched.any():
        raise PathRefusedError("the quaternion (x, y, z, w) must have length 1", int(np.argmax(stretched)))


class PathRefusedError(CommandError):
    """A path cannot be used; carries the problem and its row (from 0), or None."""

    def __init__(self, problem: str, row: int | None = None) -> None:
        self.problem, self.row = problem, row
        where = "" if row is None else f" at pose {row}"
        super().__init__(f"path refused{where}: {problem}; nothing was moved")


def _floats(what: str, values: ArrayLike) -> Array:
    try:
        return np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise PathRefusedError(f"{what} are not all numbers in rows of equal length") from error


MAZE_KEY = "anglePlanningTable"
CSV_COLUMNS = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")
SUFFIXES = (".json", ".csv")


def read_path(file: str | PathLike[str], start: ArrayLike) -> EffectorPath:
    """Read an effector path from a maze plan or a file of timed poses.

    Args:
        file: A maze plan (.json), or timed poses (.csv); a path, or the name of a file in `configs/paths`.
        start: Start of a maze plan in [m], shape (3,); a CSV file contains its own positions.

    Raises:
        ConfigError: no such file, or an invalid one; names file and row.
    """
    found = find_path(file)
    return maze_path(read_maze_plan(found), start) if found.suffix == ".json" else read_csv_path(found)


def known_paths() -> dict[str, Path]:
    """Return names and files of the paths in `configs/paths`, sorted by name."""
    paths: dict[str, Path] = {}
    for root in config_roots():
        for suffix in SUFFIXES:
            for path in (root / "paths").glob(f"*{suffix}"):
                paths.setdefault(path.name, path)
    return dict(sorted(paths.items()))


def find_path(name_or_path: str | PathLike[str]) -> Path:
    """Return the file of a path, given by its path or its name ("circle", "circle.csv").

    Raises:
        ConfigError: nothing found, two of that name, or a file of another kind; names the known paths.
    """
    text = fspath(name_or_path)
    try:
        path = Path(text).expanduser()
        is_file = path.is_file()
    except (OSError, RuntimeError, ValueError) as error:  # too long, no such user, a null byte
        raise ConfigError(shorten(text), "", f"is neither a name nor a path ({error!s:.100})") from error
    if is_file:
        if path.suffix not in SUFFIXES:
            raise ConfigError(text, "", f"a path file ends in {listing(SUFFIXES)}, not in {path.suffix!r}")
        return path.absolute()
    return known_path(text)


def known_path(text: str) -> Path:
    """Return the file of a path in `configs/paths` by its name; the working directory is not searched.

    Raises:
        ConfigError: there is none, or two of that name; names the known paths.
    """
    paths = known_paths()
    found = [file for name, file in paths.items() if text in (name, Path(name).stem)]
    if len(found) == 1:
        return found[0]
    problem = (
        "more than one path is called so; add its ending" if found else "no such file, and no known path"
    )
    raise ConfigError(text, "", f"{problem}; {known_names(text, paths, 'known paths:')}")


def is_known_path(name: str) -> bool:
    """Return whether a name alone identifies a file in `configs/paths`."""
    return any(name in (each, Path(each).stem) for each in known_paths())


def read_maze_plan(file: str | PathLike[str]) -> Array:
    """Read pairs of angles in [rad], shape (k, 2), from a JSON object with one key, `anglePlanningTable`.

    Raises:
        ConfigError: not such a file; names the pair (counted from 1).
    """
    try:
        content = json.loads(Path(file).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigError(file, "", f"cannot be read as JSON: {error}") from error
    if not isinstance(content, dict) or list(content) != [MAZE_KEY]:
        raise ConfigError(file, "", f"must be an object with the one key {MAZE_KEY}")
    table = content[MAZE_KEY]
    if not isinstance(table, list) or not table:
        raise ConfigError(file, MAZE_KEY, "must be a list of one or more pairs of angles in rad")
    for number, pair in enumerate(table, start=1):
        numbers = isinstance(pair, list) and len(pair) == 2 and {type(each) for each in pair} <= {int, float}
        if not (numbers and np.isfinite(pair).all()):
            raise ConfigError(
                file, f"{MAZE_KEY} row {number}", f"must be two finite angles in rad, not {json.dumps(pair)}"
            )
    return np.array(table, dtype=np.float64)


def read_csv_path(file: str | PathLike[str]) -> EffectorPath:
    """Read timed poses from a CSV file: time in [s], x, y, z in [m], and a unit quaternion qx, qy, qz, qw.

    Raises:
        ConfigError: not such a file; names the row (the header is row 1).
    """
    try:
        with Path(file).open(newline="", encoding="utf-8") as stream:
            lines = list(csv.reader(stream))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(file, "", f"cannot be read as comma separated values: {error}") from error
    if not lines or tuple(name.strip() for name in lines[0]) != CSV_COLUMNS:
        raise ConfigError(file, "row 1", f"the columns must be {','.join(CSV_COLUMNS)}")
    rows = [(number, line) for number, line in enumerate(lines[1:], start=2) if line]
    table = np.empty((len(rows), len(CSV_COLUMNS)))
    for index, (number, row) in enumerate(rows):
        try:
            table[index] = [float(text) for text in row]
        except ValueError as error:
            raise ConfigError(file, f"row {number}", f"must hold {len(CSV_COLUMNS)} numbers") from error
    try:
        return EffectorPath(table[:, 0], table[:, 1:4], table[:, 4:])
    except PathRefusedError as error:
        where = "" if error.row is None else f"row {rows[error.row][0]}"
        raise ConfigError(file, where, error.problem) from error
