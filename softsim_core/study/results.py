"""Reading the store of a study, complete or not."""

from __future__ import annotations

import importlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from softsim_core.arrays import Array, BoolArray, IndexArray
from softsim_core.errors import StudyError
from softsim_core.extras import install_command
from softsim_core.file_writing import write_file
from softsim_core.study.single import DONE, STATUS_WORDS
from softsim_core.study.store import zarr_package


@dataclass(frozen=True, slots=True, eq=False)
class StudyResults:
    """What a store holds of its runs.

    Attributes:
        folder: The store.
        attributes: The study, hashes, versions.
        variables, quantities: One value for each run by name, shape (runs,); quantities of three numbers
            stand there as NAME_x, NAME_y, NAME_z, those of more as NAME_0, ...; series are left out.
        units: Of all these.
        status: What became of each run, see STATUS_WORDS, shape (runs,).
        errors: Why each run is not done.
    """

    folder: Path
    attributes: Mapping[str, Any]
    variables: Mapping[str, Array]
    quantities: Mapping[str, Array]
    units: Mapping[str, str]
    status: IndexArray
    errors: tuple[str, ...]

    @property
    def done(self) -> BoolArray:
        """Which runs gave results, shape (runs,)."""
        return np.asarray(self.status == DONE)

    @property
    def counts(self) -> dict[str, int]:
        """How many runs became what."""
        counted = {word: int((self.status == k).sum()) for k, word in enumerate(STATUS_WORDS)}
        return {word: count for word, count in counted.items() if count}


def read_results(folder: str | Path) -> StudyResults:
    """What the store of a study holds.

    Raises:
        StudyError: there is no store, or it cannot be read.
    """
    path = Path(folder)
    zarr = zarr_package()
    try:
        group = zarr.open_group(str(path), mode="r", use_consolidated=False)
        attributes = dict(group.attrs)
        names = [each["name"] for key in ("variables", "measure") for each in attributes["study"][key]]
        names += ["objective"] if "objective" in group else []
        status = np.asarray(group["status"][:], dtype=np.int64)
        errors = tuple(str(each) for each in group["error"][:])
        variables: dict[str, Array] = {}
        quantities: dict[str, Array] = {}
        units: dict[str, str] = {}
        for name in names:
            array = group[name]
            if any(each.startswith("time") for each in array.metadata.dimension_names):
                continue
            into = variables if array.attrs["role"] == "variable" else quantities
            for column, values in _columns(name, np.asarray(array[:])):
                into[column], units[column] = values, str(array.attrs["units"])
    except (OSError, LookupError, TypeError, ValueError) as error:
        raise StudyError(f"{path} is no store of a study that can be read") from error
    return StudyResults(path, attributes, variables, quantities, units, status, errors)


def _columns(name: str, values: Array) -> list[tuple[str, Array]]:
    if values.ndim == 1:
        return [(name, values)]
    flat = values.reshape(len(values), -1)
    ends = "xyz" if values.shape[1:] == (3,) else [str(k) for k in range(flat.shape[1])]
    return [(f"{name}_{end}", flat[:, k]) for k, end in enumerate(ends)]


def write_parquet(results: StudyResults, file: Path) -> None:
    """A table with a row for each run; units and the study are in its metadata.

    Raises:
        StudyError: pyarrow is not installed, or the file cannot be written.
    """
    try:
        arrow = importlib.import_module("pyarrow")
        parquet = importlib.import_module("pyarrow.parquet")
    except ImportError as error:
        raise StudyError(f"--parquet needs pyarrow: {install_command('study')}") from error
    columns: dict[str, Any] = {"run": np.arange(len(results.status))}
    columns |= {**results.variables, **results.quantities}
    columns["status"] = [STATUS_WORDS[each] for each in results.status.tolist()]
    columns["error"] = list(results.errors)
    fields = [
        arrow.field(name, arrow.array(values).type, metadata={"units": results.units.get(name, "")})
        for name, values in columns.items()
    ]
    told = {
        "study": json.dumps(results.attributes["study"]),
        "versions": json.dumps(results.attributes["versions"]),
    }
    table = arrow.table(list(map(arrow.array, columns.values())), schema=arrow.schema(fields, metadata=told))
    try:
        data = arrow.BufferOutputStream()
        parquet.write_table(table, data)
        write_file(file, data.getvalue().to_pybytes())
    except OSError as error:
        raise StudyError(f"{file} cannot be written ({error.strerror or error})") from error
