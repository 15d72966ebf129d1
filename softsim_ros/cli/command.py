"""A subcommand of `softsim`: where it is, and what it is for."""

from __future__ import annotations

import importlib
from types import ModuleType
from typing import NamedTuple


class Command(NamedTuple):
    """A subcommand, imported when used: its module has `configure(parser)` and `run(arguments) -> int`.

    Attributes:
        module: Name of the module in this package.
        help: One line for `softsim --help`.
        uses_ros: It imports rclpy, which some variables of the environment would end.
        passes_on: Arguments it does not know are left to it in `arguments.rest`.
    """

    module: str
    help: str
    passes_on: bool = False
    uses_ros: bool = False

    def imported(self) -> ModuleType:
        """Its module."""
        return importlib.import_module(f"{__package__}.{self.module}")
