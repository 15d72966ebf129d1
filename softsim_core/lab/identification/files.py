"""Data sets on disk: found by name or by folder, described by their dataset.yaml."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from softsim_core.base import ConfigError, DataError, known_names
from softsim_core.lab.identification.description import DataSetDescription, SessionDescription
from softsim_core.scene.io import config_roots, read_extended, structured

DESCRIPTION: Final = "dataset.yaml"
FOLDER: Final = "datasets"
"""Of every config root, where data sets are that are known by name."""


@dataclass(frozen=True, slots=True)
class DataSet:
    """A described data set and where it is.

    Attributes:
        description: What is in it.
        file: Its dataset.yaml.
        folder: Where its tables lie.
    """

    description: DataSetDescription
    file: Path
    folder: Path

    def table_of(self, session: SessionDescription) -> Path:
        """The file of a session.

        Raises:
            DataError: it is not there.
        """
        file = self.folder / session.file
        if file.exists():
            return file
        told, variable = self.description, self.description.data.variable
        how = f", or set {variable} to it" if variable else ""
        where = (
            f". They come from: {told.source} (licence: {told.licence or 'not stated'})"
            if told.source
            else ""
        )
        raise DataError(
            f"session {session.name}",
            "",
            f"no file {file}; name the folder of the data (--data DIR){how}{where}",
        )

    @property
    def robot(self) -> str:
        """Name or file of the robot that was measured."""
        beside = self.file.parent / self.description.robot
        return str(beside) if beside.is_file() else self.description.robot


def known_data_sets() -> dict[str, Path]:
    """Names and descriptions of the data sets below the config roots, sorted by name."""
    known: dict[str, Path] = {}
    for root in config_roots():
        for file in (root / FOLDER).glob(f"*/{DESCRIPTION}"):
            known.setdefault(file.parent.name, file)
    return dict(sorted(known.items()))


def load_data_set(name_or_path: str | os.PathLike[str], data: Path | None = None) -> DataSet:
    """A data set by the name of its folder, or by the path of the folder or of its dataset.yaml.

    Args:
        name_or_path: Which.
        data: Where the tables lie; None: where the description and its environment variable say.

    Raises:
        ConfigError: nothing found, or any problem in the description, in one sentence.
    """
    file = _find(os.fspath(name_or_path))
    description = structured(read_extended(file), DataSetDescription, file, find_files=False)
    return DataSet(description, file, data if data is not None else _folder(description, file))


def _find(text: str) -> Path:
    path = Path(text).expanduser()
    if path.is_file():
        return path.absolute()
    if (path / DESCRIPTION).is_file():
        return (path / DESCRIPTION).absolute()
    known = known_data_sets()
    if text in known:
        return known[text].absolute()
    if path.is_dir():
        raise ConfigError(text, "", f"holds no {DESCRIPTION}, which says what its files are")
    raise ConfigError(text, "", f"no such folder, and no data set of that name; {known_names(text, known)}")


def _folder(description: DataSetDescription, file: Path) -> Path:
    """Where the tables lie: below the folder of the environment variable, else below the description's."""
    variable = description.data.variable
    base = os.environ.get(variable, "") if variable else ""
    return (Path(base).expanduser() if base else file.parent) / description.data.folder
