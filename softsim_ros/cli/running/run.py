"""`softsim run NODE --ros-args ...`: run one node in this process, where `ros2 run` is not installed."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from softsim_core.base import known_names
from softsim_node import ending, run_module
from softsim_ros.cli import UsageError
from softsim_ros.cli.running.nodes import NODES

NAMING = ("robot:=", "__ns:=", "--params-file")
"""Parts of arguments that may name the robot."""

HELP = ("--help", "-h")


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    width = max(map(len, NODES))
    listing = "\n".join(f"  {name:<{width}}  {entry.help}" for name, entry in NODES.items())
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = f"nodes:\n{listing}\n\nexample: softsim run simulator --ros-args -p robot:=tripod"
    parser.add_argument("node", nargs="?", help="name of the node")
    parser.add_argument("rest", nargs=argparse.REMAINDER, metavar="...", help="the node's own arguments")


def run(arguments: argparse.Namespace) -> int:
    """Run the node until it ends; an unknown name lists the known ones."""
    name = arguments.node
    if name not in NODES:
        what = f"unknown node '{name}'" if name else "which node?"
        near = known_names(name or "", NODES, "known nodes:")
        raise UsageError(f"{what}; {near}")
    with ending.orderly():
        words = [*arguments.rest, *(_name_running_robot(arguments.rest) if NODES[name].joins else ())]
        return run_module(NODES[name].module, words)


def _name_running_robot(words: Sequence[str]) -> list[str]:
    """Return arguments that name the running robot, if the given ones name none."""
    if any(sign in word for word in words for sign in (*NAMING, *HELP)):
        return []
    try:
        from softsim_ros.client import running_robot
    except ImportError:  # the node itself reports what is missing
        return []
    found = running_robot()
    if found is None:
        return []
    name = ["-p", f"robot:={found.robot}"] if found.robot else []  # empty if the node did not answer
    return ["--ros-args", *name, "-r", f"__ns:={found.namespace}"]
