"""`softsim scenes`: the robots and scenes that can be named."""

from __future__ import annotations

import argparse

from softsim_core.scene.files import config_roots, known_scenes


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("--paths", action="store_true", help="show the files, too")


def run(arguments: argparse.Namespace) -> int:
    """Print what is known, and where it was looked for."""
    for kind in ("robots", "scenes"):
        print(f"{kind}:")
        known = known_scenes(kind)
        for name, file in known.items():
            print(f"  {name}" + (f"  {file}" if arguments.paths else ""))
        if not known:
            print("  none")
    roots = ", ".join(map(str, config_roots())) or "nowhere: set SOFTSIM_CONFIG_PATH to a configs folder"
    print(f"found in: {roots}")
    return 0
