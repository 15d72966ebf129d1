"""`softsim scenes`: list the known robots and scenes, or show one of them with all its values."""

from __future__ import annotations

import argparse

from softsim_core.base import SoftSimError
from softsim_core.scene.io import config_roots, known_scenes
from softsim_ros.cli import CommandError


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("--paths", action="store_true", help="show the files, too")
    parser.add_argument(
        "--show",
        metavar="SCENE",
        help="print one, name or file, as YAML with every value that it inherits, computes or leaves out",
    )


def run(arguments: argparse.Namespace) -> int:
    """Print the known names and the searched folders, or one scene."""
    if arguments.show is not None:
        try:
            from softsim_core.scene import load_scene
            from softsim_core.scene.io import write_description

            print(write_description(load_scene(arguments.show)), end="")
        except (SoftSimError, ImportError) as error:
            raise CommandError(str(error)) from error
        return 0
    for kind in ("robots", "scenes"):
        print(f"{kind}:")
        scenes = known_scenes(kind)
        for name, file in scenes.items():
            print(f"  {name}" + (f"  {file}" if arguments.paths else ""))
        if not scenes:
            print("  none")
    roots = ", ".join(map(str, config_roots())) or "nowhere: set SOFTSIM_CONFIG_PATH to a configs folder"
    print(f"found in: {roots}")
    return 0
