"""Data sets on disk: found by name or by folder, described by their dataset.yaml."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from softsim_core.base import ConfigError, DataError, known_names
from softsim_core.lab.identification.description import DataSetDescription, SessionDescription
from softsim_core.scene.io import config_roots, read_extended, structure_description

DESCRIPTION: Final = "dataset.yaml"
FOLDER: Final = "datasets"
"""Folder below each config root that contains the data sets known by name."""


@dataclass(frozen=True, slots=True)
class DataSet:
    """A data set's description and its location.

    Attributes:
        description: The description.
        file: Its dataset.yaml.
        folder: Folder of its tables.
    """

    description: DataSetDescription
    file: Path
    folder: Path

    def table_of(self, session: SessionDescription) -> Path:
        """Return the file of a session.

        Raises:
            DataError: the file does not exist.
        """
        file = self.folder / session.file
        if file.exists():
            return file
        description, variable = self.description, self.description.data.variable
        how = f", or set {variable} to it" if variable else ""
        where = (
            f". They come from: {description.source} (licence: {description.licence or 'not stated'})"
            if description.source
            else ""
        )
        raise DataError(
            f"session {session.name}",
            "",
            f"no file {file}; name the folder of the data (--data DIR){how}{where}",
        )

    @property
    def robot(self) -> str:
        """Name or file of the measured robot."""
        beside = self.file.parent / self.description.robot
        return str(beside) if beside.is_file() else self.description.robot


def known_data_sets() -> dict[str, Path]:
    """Return names and descriptions of the data sets below the config roots, sorted by name."""
    data_sets: dict[str, Path] = {}
    for root in config_roots():
        for file in (root / FOLDER).glob(f"*/{DESCRIPTION}"):
            data_sets.setdefault(file.parent.name, file)
    return dict(sorted(data_sets.items()))


def load_data_set(name_or_path: str | os.PathLike[str], data: Path | None = None) -> DataSet:
    """Load a data set by the name of its folder, or by the path of the folder or of its dataset.yaml.

    Args:
        name_or_path: Name or path.
        data: Folder of the tables; None: as given by the description and its environment variable.

    Raises:
        ConfigError: nothing found, or any problem in the description, as one message.
    """
    file = _find(os.fspath(name_or_path))
    description = structure_description(read_extended(file), DataSetDescription, file, find_files=False)
    return DataSet(description, file, data if data is not None else _folder(description, file))


def _find(text: str) -> Path:
    path = Path(text).expanduser()
    if path.is_file():
        return path.absolute()
    if (path / DESCRIPTION).is_file():
        return (path / DESCRIPTION).absolute()
    data_sets = known_data_sets()
    if text in data_sets:
        return data_sets[text].absolute()
    if path.is_dir():
        raise ConfigError(text, "", f"holds no {DESCRIPTION}, which says what its files are")
    raise ConfigError(
        text, "", f"no such folder, and no data set of that name; {known_names(text, data_sets)}"
    )


def _folder(description: DataSetDescription, file: Path) -> Path:
    """Return the folder of the tables, below the environment variable's folder or the description's."""
    variable = description.data.variable
    base = os.environ.get(variable, "") if variable else ""
    return (Path(base).expanduser() if base else file.parent) / description.data.folder
