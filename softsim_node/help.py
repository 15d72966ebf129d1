"""What `--help` of a node says, and the options of its own beside those of ROS."""

from __future__ import annotations

import argparse
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain

from rclpy.utilities import remove_ros_args

from softsim_node.parameters import described

_WIDTH = 100


@dataclass(frozen=True)
class Program:
    """A node as a program.

    Attributes:
        name: Name of the executable.
        about: What it does, in a sentence.
        settings: Its parameters: instances of dataclasses, see `softsim_node.parameters`.
        more: A sentence about parameters that depend on the robot; empty: there are none.
        configure: Adds options of its own, without which it can be started, too.
    """

    name: str
    about: str
    settings: tuple[object, ...] = ()
    more: str = ""
    configure: Callable[[argparse.ArgumentParser], None] = lambda parser: None

    def options(self, words: Sequence[str]) -> argparse.Namespace:
        """Its own options on a command line; those of ROS are left out.

        Args:
            words: Command line without the program's name.

        Raises:
            SystemExit: after `--help` (0), or for words it does not know (2); both have been printed.
        """
        parser = argparse.ArgumentParser(
            prog=self.name,
            description=self.about,
            epilog=self._parameters(),
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
            usage="%(prog)s [-h] [options] [--ros-args -p NAME:=VALUE -r __ns:=/NAMESPACE ...]",
        )
        self.configure(parser)
        return parser.parse_args(remove_ros_args([self.name, *words])[1:])

    def _parameters(self) -> str:
        lines = ["parameters, each given as --ros-args -p NAME:=VALUE:"]
        for name, default, about in chain.from_iterable(map(described, self.settings)):
            shown = str(default).lower() if isinstance(default, bool) else str(default) or "empty"
            fixed = "; fixed after the start" if about.fixed else ""
            lines.append(f"  {name}: {about.allowed(default)}; default {shown}{fixed}")
            lines += textwrap.wrap(about.text, _WIDTH, initial_indent="      ", subsequent_indent="      ")
        if self.more:
            lines += textwrap.wrap(self.more, _WIDTH, initial_indent="  ", subsequent_indent="  ")
        return "\n".join(lines)
