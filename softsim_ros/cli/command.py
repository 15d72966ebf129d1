"""A subcommand of `softsim`: its module, its help, its parser, and colours of its output."""

from __future__ import annotations

import argparse
import importlib.util
import math
import os
import time
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, Final, NamedTuple, TextIO

from softsim_core.base import SoftSimError, did_you_mean, install_command, one_of
from softsim_node import takes_escapes

EXIT_INTERRUPTED: Final = 130
_CODES: Final = {"bold": "1", "red": "31", "green": "32", "yellow": "33"}


class CommandError(SoftSimError):
    """A command refuses or fails; `softsim` shows the reason after the command's name.

    Attributes:
        code: Exit code: 1, or 2 for wrong usage.
    """

    code = 1


class UsageError(CommandError):
    """A command was called with arguments that it does not take."""

    code = 2


def add_number(
    parser: argparse._ActionsContainer, option: str, default: float | type, metavar: str, about: str
) -> None:
    """Declare an option with a number: of the type of its default, or of a type and without a default."""
    kind, value = (default, None) if isinstance(default, type) else (type(default), default)
    parser.add_argument(option, type=kind, default=value, metavar=metavar, help=about)


def add_words(
    parser: argparse._ActionsContainer,
    option: str,
    metavar: str | None,
    about: str,
    choices: Sequence[str] | None = None,
) -> None:
    """Declare an option that may be given several times; its words are a list, empty without it."""
    parser.add_argument(option, action="append", default=[], metavar=metavar, choices=choices, help=about)


def add_out(parser: argparse._ActionsContainer, metavar: str, about: str) -> None:
    """Declare the option that names the file or folder to write."""
    parser.add_argument("-o", "--out", type=Path, metavar=metavar, help=about)


def require_matplotlib(reason: str) -> None:
    """Raise CommandError if Matplotlib is not installed; `reason` is the begin of the message."""
    if importlib.util.find_spec("matplotlib") is None:
        raise CommandError(f"{reason} matplotlib; {install_command('report')}")


class Colours:
    """Colours text for one stream, or leaves it as it is.

    It colours if the stream is a terminal with colours and the environment variable NO_COLOR is not set.
    """

    def __init__(self, stream: TextIO) -> None:
        plain = os.environ.get("NO_COLOR") or os.environ.get("TERM", "dumb") in ("", "dumb")
        self._on = not plain and stream.isatty()

    def __call__(self, colour: str, text: str) -> str:
        """Return the text in a colour: bold, red, green or yellow."""
        return f"\x1b[{_CODES[colour]}m{text}\x1b[0m" if self._on else text


def table_lines(rows: Sequence[Sequence[str]], side: str = "<") -> list[str]:
    """Return rows as lines with columns of equal width; `side` aligns all but the first, as in a format."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    sides = ("<", *side * (len(widths) - 1))
    return [
        "  ".join(f"{cell:{to}{width}}" for cell, to, width in zip(row, sides, widths, strict=True)).rstrip()
        for row in rows
    ]


class ProgressLine:
    """A line on a terminal that is rewritten in place, at most five times per second.

    Args:
        stream: Stream to which it is written.
        log_period_s: Time in [s] between lines where the stream is no terminal.
    """

    def __init__(self, stream: TextIO, log_period_s: float = math.inf) -> None:
        self._stream, self._shown = stream, takes_escapes(stream)
        self._period_s = 0.2 if self._shown else log_period_s
        self._next = 0.0 if self._shown else time.monotonic() + log_period_s

    def show(self, text: str, *, at_once: bool = False) -> None:
        """Replace the line if it is due, or `at_once`; in a log, add a line if it is due."""
        now = time.monotonic()
        if now >= self._next or (at_once and self._shown):
            self._next = now + self._period_s
            line, end = (f"\r{text:<78}", "") if self._shown else (text, "\n")
            print(line, end=end, file=self._stream, flush=True)

    def end(self, text: str = "") -> None:
        """End the line; a text replaces it, and is shown without a terminal, too."""
        if text:
            print(f"\r{text:<78}" if self._shown else text, file=self._stream)
        elif self._shown:
            print(file=self._stream)


class Parser(argparse.ArgumentParser):
    """An argparse parser with error messages that propose the nearest option or value."""

    def parse_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> Any:  # type: ignore[override]
        """Parse as argparse does, but propose the nearest known options for an unknown one."""
        arguments, rest = self.parse_known_args(args, namespace)
        if rest:
            options = [option for option in self._option_string_actions if option.startswith("--")]
            wrong = next((each for each in rest if each.startswith("-")), None)
            question = "" if wrong is None else did_you_mean(wrong.split("=")[0], options)
            self.error(f"unrecognized arguments: {' '.join(rest)}" + (f"; {question}" if question else ""))
        return arguments

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            raise argparse.ArgumentError(action, f"{value!r} is not {one_of(value, action.choices)}")


class Command(NamedTuple):
    """A subcommand, imported when used: its module has `configure(parser)` and `run(arguments) -> int`.

    Attributes:
        module: Name of the module in this package.
        help: One line for `softsim --help`.
        passes_on: Whether unknown arguments are passed to it in `arguments.rest`.
    """

    module: str
    help: str
    passes_on: bool = False

    def import_module(self) -> ModuleType:
        """Import and return its module."""
        return importlib.import_module(f"{__package__}.{self.module}")
