"""Files of effector paths: maze plans (JSON) and timed poses (CSV), found by path or by name."""

from __future__ import annotations

import csv
import io
import json
from os import PathLike, fspath
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from softsim_core.arrays import Array
from softsim_core.errors import ConfigError, listing
from softsim_core.file_writing import write_file
from softsim_core.inverse.paths import EffectorPath, PathRefusedError, maze_path
from softsim_core.scene.catalog import shortened
from softsim_core.scene.files import config_roots
from softsim_core.wrong_names import known_names

MAZE_KEY = "anglePlanningTable"
CSV_COLUMNS = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")
SUFFIXES = (".json", ".csv")


def read_path(file: str | PathLike[str], start: ArrayLike) -> EffectorPath:
    """An effector path from a file: a maze plan or timed poses.

    Args:
        file: A maze plan (.json), or timed poses (.csv); a path, or the name of a file in `configs/paths`.
        start: Where a maze plan begins, in [m], shape (3,); a CSV file has its own positions.

    Raises:
        ConfigError: no such file, or a wrong one; names file and row.
    """
    found = find_path(file)
    return maze_path(read_maze_plan(found), start) if found.suffix == ".json" else read_csv_path(found)


def known_paths() -> dict[str, Path]:
    """Names and files of the paths in `configs/paths`, sorted by name."""
    known: dict[str, Path] = {}
    for root in config_roots():
        for suffix in SUFFIXES:
            for path in (root / "paths").glob(f"*{suffix}"):
                known.setdefault(path.name, path)
    return dict(sorted(known.items()))


def find_path(name_or_path: str | PathLike[str]) -> Path:
    """The file of a path, given by its path or its name ("circle", "circle.csv").

    Raises:
        ConfigError: nothing found, two of that name, or a file of another kind; names what is known.
    """
    text = fspath(name_or_path)
    try:
        path = Path(text).expanduser()
        is_file = path.is_file()
    except (OSError, RuntimeError, ValueError) as error:  # too long, no such user, a zero in it
        raise ConfigError(shortened(text), "", f"is neither a name nor a path ({error!s:.100})") from error
    if is_file:
        if path.suffix not in SUFFIXES:
            raise ConfigError(text, "", f"a path file ends in {listing(SUFFIXES)}, not in {path.suffix!r}")
        return path.absolute()
    return known_path(text)


def known_path(text: str) -> Path:
    """The file of a path in `configs/paths` by its name, whatever lies in the working directory.

    Raises:
        ConfigError: there is none, or two of that name; names what is known.
    """
    known = known_paths()
    found = [file for name, file in known.items() if text in (name, Path(name).stem)]
    if len(found) == 1:
        return found[0]
    problem = (
        "more than one path is called so; add its ending" if found else "no such file, and no known path"
    )
    raise ConfigError(text, "", f"{problem}; {known_names(text, known, 'known paths:')}")


def is_known_path(name: str) -> bool:
    """Whether a name alone, of a file in `configs/paths`, says which path is meant."""
    return any(name in (known, Path(known).stem) for known in known_paths())


def read_maze_plan(file: str | PathLike[str]) -> Array:
    """Pairs of angles in [rad], shape (k, 2), of a JSON object with one key, `anglePlanningTable`.

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
        if not (isinstance(pair, list) and len(pair) == 2 and all(map(_is_angle, pair))):
            raise ConfigError(
                file, f"{MAZE_KEY} row {number}", f"must be two finite angles in rad, not {json.dumps(pair)}"
            )
    return np.array(table, dtype=np.float64)


def read_csv_path(file: str | PathLike[str]) -> EffectorPath:
    """Timed poses of a CSV file: time in [s], x, y, z in [m], and a unit quaternion qx, qy, qz, qw.

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


def write_csv_path(file: str | PathLike[str], path: EffectorPath) -> None:
    """Write a path as a CSV file that `read_csv_path` reads back to the same numbers.

    Raises:
        ConfigError: the file cannot be written.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    writer.writerows(np.column_stack([path.times, path.positions, path.quaternions]).tolist())
    try:
        write_file(Path(file), text.getvalue())
    except OSError as error:
        raise ConfigError(file, "", f"cannot be written: {error.strerror}") from error


def _is_angle(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and bool(np.isfinite(value))
