"""Rule for files that run code when they are read, checked where such a file is opened."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from softsim_core.base import ConfigError
from softsim_core.scene.io.files import installed_roots

XACRO: Final = ".xacro"
PROGRAMS: Final = (".py", XACRO)
"""Suffixes of programs. The text in `${...}` of a xacro file is Python."""


@dataclass(frozen=True, slots=True)
class ProgramRule:
    """Rule for programs that may run.

    Attributes:
        folders: Programs in these folders and below, and in the installation, may run; None: all may run,
            because the user named the file explicitly.
    """

    folders: tuple[Path, ...] | None = None

    def trusts(self, file: Path) -> bool:
        """Return whether a file, with links and `..` resolved, lies where programs may run."""
        if self.folders is None:
            return True
        place = file.resolve()
        return any(place.is_relative_to(each.resolve()) for each in (*installed_roots(), *self.folders))

    def allows(self, file: Path) -> bool:
        """Return whether a file may be read: it is no program, or one that may run."""
        return file.suffix not in PROGRAMS or self.trusts(file)


ANY_PROGRAM: Final = ProgramRule()
_rule: ContextVar[ProgramRule] = ContextVar("program rule", default=ANY_PROGRAM)


@contextmanager
def limited_to(rule: ProgramRule) -> Iterator[None]:
    """Within the `with` block, allow this thread to run only programs that the rule allows."""
    token = _rule.set(rule)
    try:
        yield
    finally:
        _rule.reset(token)


def may_hold_programs(folder: Path) -> bool:
    """Return whether programs in a folder may run now."""
    return _rule.get().trusts(folder)


def allowed_program(file: Path) -> Path:
    """Return the file to open for a program that is about to run: exactly the one that was checked.

    Raises:
        ConfigError: it may not run.
    """
    place = file.resolve()
    if not _rule.get().trusts(place):
        problem = (
            "is code that would run; name it in the start command, or allow its folder there: --allow-code"
        )
        raise ConfigError(file, "", f"{problem} {place.parent}")
    return place
