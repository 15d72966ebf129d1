"""The results of a study: one Zarr store that xarray opens, written block by block, and its reader.

Every array has the dimension `run`, divided into blocks. Finished runs are stored in a journal, one file per
block, until their block is complete. Then its chunks are written, that of `status` last, and the journal is
removed. So the content of the store does not depend on the order in which runs end, and an interruption at
any time loses only the unfinished runs.
"""

from __future__ import annotations

import base64
import functools
import hashlib
import importlib
import json
import math
import platform
import shutil
import warnings
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, is_dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from softsim_core.base import (
    Array,
    BoolArray,
    IndexArray,
    StudyError,
    install_command,
    make_folder,
    open_in_place,
    refuse_links,
    sync,
    sync_tree,
    version_of,
    write_file,
)
from softsim_core.lab.study.single import DONE, PENDING, RAISED, STATUS_WORDS, Outcome
from softsim_core.physics.mesh import TetMesh
from softsim_core.scene import RobotDescription
from softsim_core.scene.io import unstructure_scene

PACKAGES = ("softsim", "numpy", "scipy", "numba", "llvmlite")
"""Packages whose versions may change a bit of a result."""


@functools.cache
def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that compute."""
    return {"python": platform.python_version()} | {name: version_of(name) or "none" for name in PACKAGES}


def scene_hash(robot: RobotDescription, code: tuple[Path, ...] = ()) -> str:
    """Return the SHA-256 of a scene as built: every value, and the contents of its files and of its code."""
    digest = hashlib.sha256(json.dumps(_plain(unstructure_scene(robot)), sort_keys=True).encode())
    for file in (*code, *((robot.source,) if robot.source and robot.source.suffix == ".py" else ())):
        digest.update(file.read_bytes())
    return digest.hexdigest()


def _plain(data: Any) -> Any:
    """Convert data to JSON types; a file is replaced by its content."""
    if isinstance(data, Mapping):
        return {str(key): _plain(each) for key, each in data.items()}
    if isinstance(data, list | tuple):
        return [_plain(each) for each in data]
    if isinstance(data, TetMesh):
        cells = [data.tets, *(block.cells for block in data.blocks.values())]
        return _digest(b"".join(each.tobytes() for each in (data.points, *cells)))
    if isinstance(data, np.ndarray):
        return _digest(data.tobytes())
    if isinstance(data, str) and data.startswith("/") and Path(data).is_file():
        return _digest(Path(data).read_bytes())
    if is_dataclass(data) or not isinstance(data, str | int | float | bool | None):
        return repr(data)
    return data


def _digest(data: bytes) -> str:
    return f"sha256:{hashlib.sha256(data).hexdigest()}"


JOURNAL = "journal"
"""Folder of the journals in the store of an incomplete study."""


@dataclass(frozen=True, slots=True)
class Column:
    """An array of the store.

    Attributes:
        name: Its name.
        unit: Unit of its values.
        shape: Shape of the value of one run.
        dimensions: Names of the axes of `shape`.
        about: Description for people.
        is_variable: Whether it is a variable; else it is measured.
    """

    name: str
    unit: str
    shape: tuple[int, ...] = ()
    dimensions: tuple[str, ...] = ()
    about: str = ""
    is_variable: bool = False


@dataclass(frozen=True, slots=True)
class Plan:
    """Contents of a store.

    Attributes:
        runs: Number of runs.
        block: Runs per chunk.
        columns: Arrays with a value for each run.
        coordinates: Arrays of dimensions: name to (values, unit).
        attributes: Attributes of the store: the study, hashes, versions.
    """

    runs: int
    block: int
    columns: tuple[Column, ...]
    coordinates: Mapping[str, tuple[Array, str]]
    attributes: Mapping[str, Any]


class Store(AbstractContextManager["Store"]):
    """A store in a folder that is written by one process.

    Attributes:
        status: Status of each run, shape (runs,).

    Raises:
        StudyError: the folder contains something else, a store of another study, or is being written.
    """

    def __init__(self, folder: Path, plan: Plan) -> None:
        self.folder, self.plan = folder, plan
        if not folder.exists():
            _create(folder, plan)
        self._lock = lock_store(folder)
        try:
            self._need_same()
            refuse_links(folder)
            for torn in folder.rglob("*.partial"):  # left by an interrupted write of Zarr
                torn.unlink()
            self._group = zarr_package().open_group(str(folder), mode="r+", use_consolidated=False)
            self.status = self._read_status()
            self._rows: dict[int, dict[str, Any]] = {}
            self._open: dict[int, IO[str]] = {}
            self._read_journals()
        except OSError as error:
            self._lock.close()
            raise StudyError(f"{folder} cannot be written ({error.strerror})") from error
        except BaseException:
            self._lock.close()
            raise

    def __exit__(self, *_: object) -> None:
        for each in self._open.values():
            each.close()
        self._lock.close()

    @property
    def left(self) -> list[int]:
        """Numbers of the unfinished runs."""
        return np.flatnonzero(self.status == PENDING).tolist()

    def values(self, name: str) -> Array:
        """Return an array of the store with the values of its journals, shape (runs, ...)."""
        read: Array = self._group[name][:]
        for number, row in self._rows.items():
            if name in row["columns"]:
                read[number] = _unpack_array(row["columns"][name]).reshape(read.shape[1:])
        return read

    def errors(self) -> list[str]:
        """Return the error of each run, in order; empty where it is done."""
        errors = [str(each) for each in self._group["error"][:]]
        for number, row in self._rows.items():
            errors[number] = row["error"]
        return errors

    def add(self, number: int, values: Mapping[str, float], outcome: Outcome) -> None:
        """Store the outcome of a run with its variables, and write its block when that is complete.

        Results of another shape than the plan's make it RAISED.

        Raises:
            StudyError: the disk is full, or the store cannot be written.
        """
        shapes = {each.name: each.shape for each in self.plan.columns}
        for name, value in outcome.results.items():
            if value.shape != shapes[name]:
                error = f"{name} has the shape {value.shape}, in other runs it is {shapes[name]}"
                outcome = Outcome(RAISED, error, {})
                break
        columns = {
            name: base64.b64encode(np.asarray(value, dtype="<f8").tobytes()).decode()
            for name, value in {**values, **outcome.results}.items()
        }
        row = {"run": number, "status": outcome.status, "error": outcome.error, "columns": columns}
        block = number // self.plan.block
        try:
            journal = self._open.get(block)
            if journal is None:
                make_folder(self.folder / JOURNAL)
                journal = open_in_place(self._journal(block), "a", encoding="utf-8")
                self._open[block] = journal
            journal.write(json.dumps(row) + "\n")
            journal.flush()
            self._take(row)
            self._write_if_complete(block)
        except OSError as error:
            raise StudyError(
                f"{self.folder} cannot be written ({error.strerror}); make room, and the same command "
                "continues"
            ) from error

    def _take(self, row: dict[str, Any]) -> None:
        self._rows[row["run"]] = row
        self.status[row["run"]] = row["status"]

    def _journal(self, block: int) -> Path:
        return self.folder / JOURNAL / f"{block:08d}.jsonl"

    def _range(self, block: int) -> range:
        return range(block * self.plan.block, min((block + 1) * self.plan.block, self.plan.runs))

    def _write_if_complete(self, block: int) -> None:
        numbers = self._range(block)
        if not all(number in self._rows for number in numbers):
            return
        rows = [self._rows[number] for number in numbers]
        part = slice(numbers.start, numbers.stop)
        for column in self.plan.columns:
            values = np.full((len(rows), *column.shape), np.nan)
            for k, row in enumerate(rows):
                if column.name in row["columns"]:
                    values[k] = _unpack_array(row["columns"][column.name]).reshape(column.shape)
            self._group[column.name][part] = values
        self._group["error"][part] = np.array([row["error"] for row in rows], dtype=object)
        self._sync_chunks(block, [*(column.name for column in self.plan.columns), "error"])
        self._group["status"][part] = np.array([row["status"] for row in rows], dtype=np.int8)
        self._sync_chunks(block, ["status"])
        for number in numbers:
            del self._rows[number]
        if (journal := self._open.pop(block, None)) is not None:
            journal.close()
        self._journal(block).unlink(missing_ok=True)
        if not any((self.folder / JOURNAL).iterdir()):
            (self.folder / JOURNAL).rmdir()

    def _sync_chunks(self, block: int, names: Sequence[str]) -> None:
        """Flush a block of arrays to the disk before anything else is written."""
        for name in names:
            chunks = self.folder / name / "c"
            sync_tree(chunks / str(block))
            if chunks.is_dir():  # an array without any value has none
                sync(chunks)
                sync(chunks.parent)

    def _read_status(self) -> IndexArray:
        try:
            status = np.asarray(self._group["status"][:], dtype=np.int64)
        except Exception as error:  # decoders of damaged chunks raise various errors
            raise StudyError(f"{self.folder}/status is damaged ({error}); choose another --out") from error
        if status.shape != (self.plan.runs,) or not np.isin(status, range(len(STATUS_WORDS))).all():
            raise StudyError(f"{self.folder}/status is damaged; choose another store with --out")
        return status

    def _read_journals(self) -> None:
        """Read the finished runs from the journals; an incomplete last line counts as not finished."""
        for file in sorted((self.folder / JOURNAL).glob("*.jsonl")):
            if not (file.stem.isdecimal() and self._range(block := int(file.stem))):
                raise StudyError(f"{file} is no journal of this store; remove it")
            good = 0
            with file.open("rb") as stream:
                for place, line in enumerate(stream, start=1):
                    if not line.endswith(b"\n"):
                        break
                    try:
                        row = self._read_row(line, self._range(block))
                    except (ValueError, TypeError, AttributeError, RecursionError) as error:
                        numbers = self._range(block)
                        raise StudyError(
                            f"{file}, line {place}: is damaged ({error}); remove this file, and the runs "
                            f"{numbers.start} to {numbers.stop - 1} are done again"
                        ) from error
                    good += len(line)
                    if self.status[row["run"]] == PENDING or row["run"] in self._rows:
                        self._take(row)
            if good < file.stat().st_size:
                with open_in_place(file, "r+b") as stream:
                    stream.truncate(good)
            if all(
                self.status[number] != PENDING and number not in self._rows for number in self._range(block)
            ):
                file.unlink()  # the block is complete, but its journal remained
            else:
                self._write_if_complete(block)
        if (self.folder / JOURNAL).is_dir() and not any((self.folder / JOURNAL).iterdir()):
            (self.folder / JOURNAL).rmdir()

    def _read_row(self, line: bytes, numbers: range) -> dict[str, Any]:
        """Parse one line of the journal of a block; a damaged one raises the errors caught above."""
        row: dict[str, Any] = json.loads(line)
        if set(row) != {"run", "status", "error", "columns"}:
            raise ValueError("it must hold run, status, error and columns")
        if type(row["run"]) is not int or row["run"] not in numbers:
            raise ValueError(f"run must be within {numbers.start}..{numbers.stop - 1}")
        if type(row["status"]) is not int or row["status"] not in range(PENDING + 1, len(STATUS_WORDS)):
            raise ValueError(f"status must be within {PENDING + 1}..{len(STATUS_WORDS) - 1}")
        if not isinstance(row["error"], str):
            raise ValueError("error must be text")
        shapes = {each.name: each.shape for each in self.plan.columns}
        for name, packed in row["columns"].items():
            if name not in shapes or _unpack_array(packed).size != math.prod(shapes[name]):
                raise ValueError("columns hold other values than the study has")
        return row

    def _need_same(self) -> None:
        """Reject a store of another study; the error names the differences."""
        try:
            stored = dict(json.loads((self.folder / "zarr.json").read_text(encoding="utf-8"))["attributes"])
        except (OSError, LookupError, TypeError, ValueError, RecursionError) as error:
            raise StudyError(f"{self.folder} is no store of a study; choose another with --out") from error
        for name, what in (("study", "the study"), ("scene_sha256", "its scene"), ("versions", "a version")):
            if stored.get(name) != self.plan.attributes[name]:
                raise StudyError(
                    f"{self.folder} holds results from before {what} changed; choose another store with "
                    "--out, or remove it"
                )


def _create(folder: Path, plan: Plan) -> None:
    """Create the complete store beside its place, then move it there."""
    zarr = zarr_package()
    making = folder.with_name(f".{folder.name}.new")
    try:
        shutil.rmtree(making, ignore_errors=True)
        making.mkdir(parents=True)
        group = zarr.create_group(str(making), attributes=dict(plan.attributes))

        def create_array(column: Column, kind: Any, fill_value: Any, attributes: Mapping[str, Any]) -> None:
            group.create_array(
                column.name,
                shape=(plan.runs, *column.shape),
                chunks=(max(1, min(plan.block, plan.runs)), *column.shape),
                dtype=kind,
                fill_value=fill_value,
                dimension_names=("run", *column.dimensions),
                attributes=attributes,
            )

        for column in plan.columns:
            attributes = {"units": column.unit, "long_name": column.about or column.name}
            attributes["role"] = "variable" if column.is_variable else "quantity"
            create_array(column, "float64", np.nan, attributes)
        flags = {"flag_values": list(range(len(STATUS_WORDS))), "flag_meanings": " ".join(STATUS_WORDS)}
        status = {**flags, "long_name": "what became of the run"}
        create_array(Column("status", ""), "int8", PENDING, status)
        create_array(Column("error", ""), str, "", {"long_name": "why a run is not done"})
        for name, (values, unit) in plan.coordinates.items():
            array = group.create_array(
                name,
                shape=values.shape,
                chunks=values.shape,
                dtype=values.dtype if values.dtype.kind == "f" else str,
                dimension_names=(name,),
                attributes={"units": unit} if unit else {},
            )
            array[:] = values
        with warnings.catch_warnings():  # warns at every call that other readers may not support it
            warnings.simplefilter("ignore")
            zarr.consolidate_metadata(str(making))
        sync_tree(making)
        making.rename(folder)
        sync(folder.parent)
    except OSError as error:
        raise StudyError(f"{folder} cannot be made ({error.strerror}); choose another with --out") from error


def lock_store(folder: Path) -> IO[str]:
    """Lock the store's description until it is closed; the lock is released even by kill -9.

    On systems without such locks, concurrent writers are not prevented.
    """
    try:
        lock = (folder / "zarr.json").open(encoding="utf-8")
    except OSError as error:
        raise StudyError(f"{folder} is no store of a study; choose another with --out") from error
    try:
        import fcntl
    except ImportError:  # no POSIX system
        return lock
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        lock.close()
        raise StudyError(f"{folder} is being written by another process; wait for it") from None
    return lock


def zarr_package() -> Any:
    """Return the package Zarr, or raise StudyError if it is not installed."""
    try:
        return importlib.import_module("zarr")
    except ImportError as error:
        raise StudyError(
            f"studies need Dask and Zarr 3 (Python 3.11 or newer): {install_command('study')}"
        ) from error


def _unpack_array(text: str) -> Array:
    return np.frombuffer(base64.b64decode(text), dtype="<f8")


def count_runs(status: IndexArray) -> dict[str, int]:
    """Return the number of runs by status word, without those that no run has."""
    counted = {word: int((status == k).sum()) for k, word in enumerate(STATUS_WORDS)}
    return {word: count for word, count in counted.items() if count}


@dataclass(frozen=True, slots=True, eq=False)
class StudyResults:
    """Contents of a store by run.

    Attributes:
        folder: The store.
        attributes: The study, hashes, versions.
        variables, quantities: One value for each run by name, shape (runs,); quantities of three numbers are
            named NAME_x, NAME_y, NAME_z, larger ones NAME_0, ...; series are left out.
        units: Units of all these.
        status: Status of each run, see STATUS_WORDS, shape (runs,).
        errors: Error of each run.
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
        """Which runs have results, shape (runs,)."""
        return np.asarray(self.status == DONE)

    @property
    def counts(self) -> dict[str, int]:
        """Number of runs by status word."""
        return count_runs(self.status)


def read_results(folder: str | Path) -> StudyResults:
    """Read the store of a study.

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
    """Write a table with one row per run; units and the study are in its metadata.

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
    texts = {
        "study": json.dumps(results.attributes["study"]),
        "versions": json.dumps(results.attributes["versions"]),
    }
    table = arrow.table(list(map(arrow.array, columns.values())), schema=arrow.schema(fields, metadata=texts))
    try:
        data = arrow.BufferOutputStream()
        parquet.write_table(table, data)
        write_file(file, data.getvalue().to_pybytes())
    except OSError as error:
        raise StudyError(f"{file} cannot be written ({error.strerror or error})") from error
