"""`softsim run NODE --ros-args ...`: one node in this process, where `ros2 run` is not installed."""

from __future__ import annotations

import argparse
import sys

from softsim_node.ending import ending
from softsim_node.program import run_module
from softsim_ros.cli.nodes import NODES


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
        print(f"softsim run: {what}; known nodes: {', '.join(NODES)}", file=sys.stderr)
        return 2
    with ending.orderly():
        return run_module(NODES[name].module, arguments.rest)
