"""Tables of measured numbers: CSV with a header line, and C3D files of motion capture.

Source: https://www.c3d.org, The C3D file format.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from softsim_core.base import SCALES, Array, DataError, IndexArray, known_names, listing


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Columns of equal length, as text or as numbers.

    Attributes:
        file: File from which they were read.
        columns: Cells of the columns by name.
        lines: Names of the rows in messages: their lines in the file, counted from 1; also its name in a
            table of several files.
        origins: Index of the file of each row in a table of several files; empty: there is one.
    """

    file: Path
    columns: Mapping[str, Sequence[str] | Array]
    lines: Sequence[int | str]
    origins: Sequence[int] = ()

    def __len__(self) -> int:
        return len(self.lines)

    def part(self, rows: IndexArray) -> Table:
        """Return only the rows of the indices."""
        chosen = rows.tolist()
        columns = {name: [cells[k] for k in chosen] for name, cells in self.columns.items()}
        origins = [self.origins[k] for k in chosen] if self.origins else ()
        return Table(self.file, columns, [self.lines[k] for k in chosen], origins)

    def numbers(self, name: str, unit: str | None = None) -> Array:
        """Return a column in SI units, all numbers finite, shape (rows,).

        Args:
            name: The column.
            unit: Unit of its cells; None: they are dimensionless.

        Raises:
            DataError: no such column, a cell that is no finite number, or a name that indicates another unit.
        """
        if name not in self.columns:
            raise DataError(
                self.file, f"column {name}", f"is not there; {known_names(name, self.columns, 'there are')}"
            )
        if unit is not None:
            _, _, ending = name.rpartition("_")
            if ending != name and ending in SCALES and ending != unit:
                raise DataError(
                    self.file,
                    f"column {name}",
                    f"is declared in {unit}, but its name says {ending}; correct one",
                )
        values = np.array([_number(cell) for cell in self.columns[name]], dtype=float)
        wrong = np.flatnonzero(~np.isfinite(values))
        if len(wrong):
            where = int(wrong[0])
            cell = self.columns[name][where]
            more = f" (and {len(wrong) - 1} more)" if len(wrong) > 1 else ""
            raise DataError(
                self.file,
                f"column {name}, line {self.lines[where]}",
                f"holds {str(cell)!r}, no finite number{more}; leave such rows out, or mark them as suspect",
            )
        return values * (1.0 if unit is None else SCALES[unit].si)


def read_csv(file: Path, columns: Sequence[str] = ()) -> Table:
    """Read a CSV file: lines starting with # are comments, the first other line contains the column names.

    All columns are read, whatever is requested.

    Raises:
        DataError: it cannot be read, has no rows, names a column twice, or a row has another number of
            columns.
    """
    try:
        with file.open(encoding="utf-8-sig", newline="") as stream:
            rows = [
                (number, row)
                for number, row in enumerate(csv.reader(stream), start=1)
                if row and not row[0].lstrip().startswith("#")
            ]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DataError(file, "", f"cannot be read as CSV ({error})") from error
    if len(rows) < 2:
        raise DataError(file, "", "holds no rows below a header line")
    names = [name.strip() for name in rows[0][1]]
    for between, word in ((";", "semicolons"), ("\t", "tabs")):
        if len(names) == 1 and between in names[0]:
            line = f"line {rows[0][0]}"
            raise DataError(
                file, line, f"has {word} between its cells; save it with commas, and points in numbers"
            )
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise DataError(file, f"line {rows[0][0]}", f"names the column {twice[0]!r} twice")
    if all(math.isfinite(_number(name)) for name in names):
        raise DataError(file, f"line {rows[0][0]}", "holds numbers where the names of the columns must stand")
    for number, row in rows[1:]:
        if len(row) != len(names):
            raise DataError(file, f"line {number}", f"has {len(row)} cells for {len(names)} columns")
    cells = list(zip(*(row for _, row in rows[1:]), strict=True))
    return Table(file, dict(zip(names, cells, strict=True)), [number for number, _ in rows[1:]])


def join_tables(tables: Sequence[Table]) -> Table:
    """Return the rows of all tables, with the columns that all of them have; `file` is that of the first."""
    first = tables[0]
    if len(tables) == 1:
        return first
    shared = [name for name in first.columns if all(name in each.columns for each in tables)]
    return Table(
        first.file,
        {name: [cell for each in tables for cell in each.columns[name]] for name in shared},
        [f"{line} of {each.file.name}" for each in tables for line in each.lines],
        [k for k, each in enumerate(tables) for _ in each.lines],
    )


def _number(cell: object) -> float:
    try:
        return float(cell)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return math.nan


TIME: Final = "time_s"
"""The column with the time since the file's first frame."""


def read_c3d(file: Path, columns: Sequence[str]) -> Table:
    """Read points and analog channels of a C3D file; a row is a frame with all requested points visible.

    A point's columns are LABEL:x_UNIT, LABEL:y_UNIT and LABEL:z_UNIT with the unit of the file, such as
    `tip:x_mm`. The column of an analog channel is LABEL, with its first sample in the frame. The time is
    `time_s`.

    Raises:
        DataError: the file cannot be read, or no frame contains all requested points.
    """
    try:
        import c3d
    except ImportError as error:
        raise DataError(
            file, "", "C3D files need the package c3d (pip install c3d), or export CSV"
        ) from error
    try:
        with file.open("rb") as stream:
            reader = c3d.Reader(stream)
            frames = [(points[:, :4], analog[:, :1]) for _, points, analog in reader.read_frames(copy=True)]
            columns_by_name = _columns(reader, frames)
            rate = float(reader.point_rate)
    except Exception as error:  # a damaged file can fail anywhere in the reader
        raise DataError(file, "", f"cannot be read as C3D ({error})") from error
    if not frames or not rate > 0.0:
        raise DataError(file, "", "holds no frames, or no rate of them")
    columns_by_name[TIME] = np.arange(len(frames)) / rate
    asked = [columns_by_name[name] for name in columns if name in columns_by_name]
    measured = np.all([np.isfinite(each) for each in asked], axis=0) if asked else np.ones(len(frames), bool)
    if not measured.any():
        raise DataError(file, "", f"no frame shows all of {', '.join(columns)}")
    columns_measured = {name: values[measured] for name, values in columns_by_name.items()}
    return Table(file, columns_measured, (np.flatnonzero(measured) + 1).tolist())


def _columns(reader: Any, frames: Sequence[tuple[Array, Array]]) -> dict[str, Array]:
    """Return all columns of the frames; NaN where a point was not visible."""
    unit = reader.get("POINT:UNITS")
    name = "mm" if unit is None else unit.string_value.strip() or "mm"
    columns: dict[str, Array] = {}
    for k, label in enumerate(map(str.strip, reader.point_labels)):
        points = np.array([frame[k] for frame, _ in frames], dtype=float).reshape(-1, 4)
        points[points[:, 3] < 0.0] = np.nan
        columns |= {f"{label}:{axis}_{name}": points[:, i] for i, axis in enumerate("xyz")}
    for k, label in enumerate(map(str.strip, reader.analog_labels if reader.analog_used else ())):
        columns[label] = np.array([analog[k, 0] for _, analog in frames], dtype=float)
    return columns


TableReader = Callable[[Path, Sequence[str]], Table]
"""Function that reads some columns of a file."""

READERS: dict[str, TableReader] = {".csv": read_csv, ".c3d": read_c3d}
"""Readers by file ending; an interface adds those of its recordings."""


def read_table(file: Path, columns: Sequence[str]) -> Table:
    """Read columns of a table with the reader of its file ending.

    Raises:
        DataError: it cannot be read, or has an unknown ending.
    """
    reader = READERS.get(file.suffix.lower())
    if reader is None:
        raise DataError(file, "", f"is no table that is known here; known are {listing(READERS)}")
    return reader(file, columns)
