"""The parser of every subcommand: a wrong word is answered with the ones that may have been meant."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

from softsim_core.wrong_names import did_you_mean, one_of


class Parser(argparse.ArgumentParser):
    """An argparse parser whose refusals propose the nearest option or value."""

    def parse_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> Any:  # type: ignore[override]
        """As argparse's, but an unknown option is answered with the nearest known ones."""
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
