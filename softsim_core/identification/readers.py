"""What reads a table of measurements, by the ending of its file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from softsim_core.errors import DataError, listing
from softsim_core.identification.c3d_table import read_c3d
from softsim_core.identification.table import Table, read_csv

TableReader = Callable[[Path, Sequence[str]], Table]
"""Reads some columns of a file."""

READERS: dict[str, TableReader] = {".csv": read_csv, ".c3d": read_c3d}
"""By ending; an interface adds those of its recordings."""


def read_table(file: Path, columns: Sequence[str]) -> Table:
    """Columns of a table, by the ending of its file.

    Raises:
        DataError: it cannot be read, or has an unknown ending.
    """
    reader = READERS.get(file.suffix.lower())
    if reader is None:
        raise DataError(file, "", f"is no table that is known here; known are {listing(READERS)}")
    return reader(file, columns)
