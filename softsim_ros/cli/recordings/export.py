"""`softsim export BAG`: write tables (CSV), meshes for ParaView (VTU), and a replay page (HTML)."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from softsim_ros.cli import CommandError, UsageError, add_number, add_out

if TYPE_CHECKING:
    from softsim_ros.recording import Bag

FORMATS = ("csv", "vtu", "html")


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("bag", type=Path, help="folder of a recording, or an .mcap or .db3 file")
    add_out(parser, "FOLDER", "where to write (BAG_export)")
    parser.add_argument("--csv", action="store_true", help="one table a topic")
    parser.add_argument("--vtu", action="store_true", help="the mesh with its von Mises stress, for ParaView")
    parser.add_argument("--html", action="store_true", help="a replay in one web page")
    add_number(parser, "--rate", float, "HZ", "meshes a second of the recording in the VTU files (all)")
    parser.epilog = "Without --csv, --vtu or --html: all three."


def run(arguments: argparse.Namespace) -> int:
    """Write the requested formats; report what a bag does not contain."""
    from softsim_ros.recording import Bag

    if arguments.rate is not None and not arguments.rate > 0.0:
        raise UsageError("--rate must be above 0 Hz")
    chosen = [name for name in FORMATS if getattr(arguments, name)] or list(FORMATS)
    folder = arguments.out or arguments.bag.resolve().with_name(f"{arguments.bag.resolve().stem}_export")
    with Bag(arguments.bag) as bag:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if "csv" in chosen:
                _export_csv(bag, folder)
            if "vtu" in chosen:
                _export_vtu(bag, folder, arguments.rate)
            if "html" in chosen:
                _export_html(bag, folder)
        except OSError as error:
            raise CommandError(f"{folder} cannot be written ({error.strerror})") from error
    return 0


def _export_csv(bag: Bag, folder: Path) -> None:
    from softsim_ros.recording import write_csv

    files, left_out = write_csv(bag, folder)
    print(f"{folder}: {len(files)} tables ({', '.join(file.name for file in files)})")
    if left_out:
        print(f"not as tables, too long: {', '.join(left_out)}")


def _export_vtu(bag: Bag, folder: Path, rate: float | None) -> None:
    from softsim_ros.recording import SURFACE, VOLUME, mesh_frames, write_vtu_series

    for name, topics in (("surface", SURFACE), ("volume", VOLUME)):
        if bag.counts.get(bag.topic(topics.points)):
            file, count = write_vtu_series(mesh_frames(bag, topics, rate), topics.kind, folder, name)
            print(f"{file}: {count} meshes; open it in ParaView")
        else:
            print(f"no {name} for ParaView: {bag.topic(topics.points)} is not in the bag")


def _export_html(bag: Bag, folder: Path) -> None:
    from softsim_core.base import write_file
    from softsim_ros.recording import BagError, html_replay

    try:
        page = html_replay(bag)
    except BagError as error:
        print(f"no replay page: {error}")
        return
    file = write_file(folder / "replay.html", page)
    print(f"{file}: open it in a browser ({1e-6 * len(page):.1f} MB)")
