"""Files that run code when they are read, and which may: one rule, asked where such a file is opened."""

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
"""Suffixes of programs. What stands in `${...}` of a xacro file is Python."""


@dataclass(frozen=True, slots=True)
class ProgramRule:
    """Which programs may run.

    Attributes:
        folders: Those in these folders and below, and the installation's; None: all, since what a person
            named leads where that person wants.
    """

    folders: tuple[Path, ...] | None = None

    def trusts(self, file: Path) -> bool:
        """Whether a file, its links and `..` followed, lies where programs may run."""
        if self.folders is None:
            return True
        place = file.resolve()
        return any(place.is_relative_to(each.resolve()) for each in (*installed_roots(), *self.folders))

    def allows(self, file: Path) -> bool:
        """Whether a file may be read: it is no program, or one that may run."""
        return file.suffix not in PROGRAMS or self.trusts(file)


ANY_PROGRAM: Final = ProgramRule()
_rule: ContextVar[ProgramRule] = ContextVar("program rule", default=ANY_PROGRAM)


@contextmanager
def limited_to(rule: ProgramRule) -> Iterator[None]:
    """Within the `with` block, in this thread, no program runs but those that the rule allows."""
    token = _rule.set(rule)
    try:
        yield
    finally:
        _rule.reset(token)


def may_hold_programs(folder: Path) -> bool:
    """Return whether programs in a folder may run now."""
    return _rule.get().trusts(folder)


def allowed_program(file: Path) -> Path:
    """The file to open where a program is about to be read and run: exactly the one that was checked.

    Raises:
        ConfigError: it may not run.
    """
    place = file.resolve()
    if not _rule.get().trusts(place):
        raise ConfigError(
            file,
            "",
            "is code that would run; name it in the start command, or allow its folder there: --allow-code "
            f"{place.parent}",
        )
    return place
