"""A data set that is being recorded: a folder that can be read after every session."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from softsim_core.arrays import Array
from softsim_core.identification.description import DataSetDescription, SessionDescription
from softsim_core.identification.files import load_data_set
from softsim_core.identification.session import load_session
from softsim_core.identification.writing import (
    first_calibration,
    write_calibration,
    write_description,
    write_table,
)
from softsim_core.scene.robot import RobotDescription
from softsim_ros.excitation.errors import ExcitationError


class SetFolder:
    """A new folder with a data set, whole after every change.

    Args:
        folder: Where; it must not exist.
        robot: Name of the robot, or its file.
        about: What it is, in a sentence.
        source: Who measured it, and how.

    Raises:
        ExcitationError: it exists.
    """

    def __init__(self, folder: Path, robot: str, about: str, source: str) -> None:
        try:
            folder.mkdir(parents=True)
        except FileExistsError as error:
            raise ExcitationError(f"{folder} is there already; give another folder with --out") from error
        except OSError as error:
            raise ExcitationError(f"{folder} cannot be made ({error.strerror})") from error
        self.folder = folder
        self._described = partial(
            DataSetDescription, name=folder.name, robot=robot, about=about, source=source
        )
        self._sessions: dict[str, SessionDescription] = {}

    @property
    def sessions(self) -> tuple[SessionDescription, ...]:
        """What there is so far."""
        return tuple(self._sessions.values())

    def put(self, session: SessionDescription, columns: dict[str, Array]) -> None:
        """Write a session, or write it anew.

        Raises:
            ExcitationError: the disk takes no more.
        """
        try:
            write_table(self.folder / session.file, columns, [session.note])
            self._sessions[session.name] = session
            write_description(self.folder, self._described(sessions=self.sessions))
        except OSError as error:
            raise ExcitationError(f"{self.folder} cannot be written ({error.strerror})") from error

    def finish(self, robot: RobotDescription) -> list[str]:
        """Write a calibration to begin with, and read all as others will; returns what is told of it.

        Raises:
            DataError: the sensors gave what nobody can use.
        """
        at_rest = [each.name for each in self.sessions if each.time is None]
        names = at_rest or [each.name for each in self.sessions]
        data, told = load_data_set(self.folder), []
        for each in data.description.sessions:
            rows = load_session(data, each)
            told.append(f"{each.name}: {len(rows.table)} rows, {int(rows.used.sum())} of them count")
        calibration = first_calibration(self.folder.name, robot, names, not at_rest)
        if calibration is not None:
            write_calibration(self.folder, calibration)
        return told
