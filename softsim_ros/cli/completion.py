"""`softsim completion SHELL`: code with which Tab completes commands, options, robots and materials."""

from __future__ import annotations

import argparse
import os
import pkgutil
from collections.abc import Mapping
from typing import Any, Final

from softsim_core.base import install_command
from softsim_ros.cli.command import Command, CommandError, Parser

SHELLS: Final = ("bash", "zsh", "fish")
LINES: Final = {
    "bash": "echo 'eval \"$(softsim completion bash)\"' >> ~/.bashrc",
    "zsh": "echo 'eval \"$(softsim completion zsh)\"' >> ~/.zshrc",
    "fish": "softsim completion fish > ~/.config/fish/completions/softsim.fish",
}
ASKED: Final = "_ARGCOMPLETE"
"""Variable that a shell sets when it asks for completions."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("shell", choices=SHELLS, help="which shell")
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = "once:\n" + "\n".join(f"  {line}" for line in LINES.values())


def run(arguments: argparse.Namespace) -> int:
    """Print the shell's code."""
    try:
        from argcomplete.shell_integration import shellcode
    except ImportError as error:
        raise CommandError(f"argcomplete is not installed; {install_command('completion')}") from error
    print(shellcode(["softsim"], shell=arguments.shell))
    return 0


def complete(commands: Mapping[str, Command]) -> None:
    """Answer a shell's request for completions of `commands`, by name, and end the process."""
    import argcomplete

    words = os.environ.get("COMP_LINE", "").split()
    parser = Parser(prog="softsim", allow_abbrev=False)
    parser.add_argument("--version", action="store_true")
    below = parser.add_subparsers()
    for name, command in commands.items():
        own = below.add_parser(name, help=command.help, allow_abbrev=False)
        if name in words[1:2]:  # the others are not imported
            command.import_module().configure(own)
            for action in own._actions:
                names = _NAMES.get((name, action.dest), _NAMES.get(("", action.dest)))
                if names is not None:
                    action.completer = _Completer(names)  # type: ignore[attr-defined]
    argcomplete.autocomplete(parser, always_complete_options=True)


_NAMES: Final = {
    ("", "robot"): "softsim_core.scene.io:known_scenes",
    ("scenes", "show"): "softsim_core.scene.io:known_scenes",
    ("run", "node"): "softsim_ros.cli.running:NODES.keys",
    ("material", "name"): "softsim_core.physics.fem.materials:elastomer_names",
    ("validate", "data_set"): "softsim_core.lab.identification:known_data_sets",
    ("league", "data_sets"): "softsim_core.lab.identification:known_data_sets",
    ("calibrate", "calibration"): "softsim_core.lab.identification:known_data_sets",
}
"""Functions that list the values of an argument, by command (empty: of any) and argument."""


class _Completer:
    """Lists the names that begin as the word to complete; the function is imported when it is needed."""

    def __init__(self, function: str) -> None:
        self._function = function

    def __call__(self, prefix: str, **_: Any) -> list[str]:
        return [name for name in pkgutil.resolve_name(self._function)() if name.startswith(prefix)]
