"""Which scene files a simulator may write, and writing them: whole, and never over others' changes."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from softsim_core.errors import ConfigError
from softsim_core.file_writing import write_file
from softsim_core.scene.files import installed_roots

MOST_BYTES: Final = 4_000_000
SUFFIXES: Final = (".yaml", ".yml")


class SceneWriter:
    """Reads and writes scene files for the edit mode.

    Written is the file that the start command named, if it is the user's own; besides, a copy of a scene into
    the start folder, where no file of that name is.

    Args:
        named: The files that the start command named.
        start_folder: Where copies go; None: nowhere.
    """

    def __init__(self, named: Iterable[Path], start_folder: Path | None) -> None:
        self._own = {file.absolute() for file in named}
        self._start_folder = start_folder

    def refusal(self, file: Path) -> str:
        """Why a file is not written, in one sentence; "": it may be."""
        if any(file.resolve().is_relative_to(root.resolve()) for root in installed_roots()):
            return f"{file.name} came with softsim and is not overwritten; save a copy"
        if file.absolute() not in self._own:
            return f"{file.name} was not named by the start command, so it is not written; save a copy"
        try:
            status = file.lstat()
        except OSError as error:
            return f"{file} cannot be looked at ({error.strerror})"
        if not stat.S_ISREG(status.st_mode):
            return f"{file} is a link or no ordinary file, so it is not written; start with the file itself"
        if not os.access(file, os.W_OK) or not os.access(file.parent, os.W_OK):
            return f"{file} must not be written by this user; change its rights, or save a copy"
        return ""

    def read(self, file: Path) -> str:
        """The text of a file.

        Raises:
            ConfigError: it cannot be edited.
        """
        if file.suffix not in SUFFIXES:
            raise ConfigError(file, "", "is a program, which is edited by hand; the page edits YAML files")
        try:
            with file.open("rb") as stream:
                data = stream.read(MOST_BYTES + 1)
            if len(data) > MOST_BYTES:
                raise ConfigError(file, "", f"is longer than {MOST_BYTES} bytes; edit it by hand")
            if b"\r" in data:
                raise ConfigError(file, "", "has lines that end as under Windows; save it with those of Unix")
            return data.decode("utf-8")
        except UnicodeDecodeError as error:
            raise ConfigError(file, "", f"is not UTF-8 text (byte {error.start})") from error
        except OSError as error:
            raise ConfigError(file, "", f"cannot be read ({error.strerror or error})") from error

    def write(self, file: Path, text: str, before: str) -> None:
        """Write a file that still holds the text `before`.

        Raises:
            ConfigError: it must not be written, cannot be, or has changed.
        """
        if sentence := self.refusal(file):
            raise ConfigError(file, "", f"not saved: {sentence}")
        if self.read(file) != before:
            raise ConfigError(
                file,
                "",
                "not saved: it was changed on the disk since it was read; discard the proposal to take that, "
                "or save a copy",
            )
        try:
            write_file(file, text)
        except OSError as error:
            raise ConfigError(file, "", f"not saved: {error.strerror}") from error

    def copy(self, name: str, text: str) -> Path:
        """Write a new file NAME.yaml in the start folder, which may be written again from then on.

        Raises:
            ConfigError: there is one already, or it cannot be written.
        """
        if self._start_folder is None:
            raise ConfigError(f"{name}.yaml", "", "not saved: the folder of the start command is gone")
        file = self._start_folder / f"{name}.yaml"
        try:
            write_file(file, text, replaces=False)
        except FileExistsError as error:
            raise ConfigError(file, "", "not saved: there is a file of this name; move it away") from error
        except OSError as error:
            raise ConfigError(file, "", f"not saved: {error.strerror}") from error
        self._own.add(file.absolute())
        return file
