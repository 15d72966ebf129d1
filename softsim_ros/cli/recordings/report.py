"""`softsim report BAG`: write charts and the moving picture of a recording into one web page."""

from __future__ import annotations

import argparse
from pathlib import Path

from softsim_ros.cli import add_out, require_matplotlib


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("bag", type=Path, help="folder of a recording, or an .mcap or .db3 file")
    add_out(parser, "HTML", "where to write (BAG_report.html)")


def run(arguments: argparse.Namespace) -> int:
    """Write the page."""
    require_matplotlib("charts need")
    from softsim_ros import write_page
    from softsim_ros.recording import Bag, report

    bag_path = arguments.bag.resolve()
    file = arguments.out or bag_path.with_name(f"{bag_path.stem}_report.html")
    with Bag(arguments.bag) as bag:
        page = report(bag)
    write_page(file, page)
    print(f"{file}: open it in a browser ({1e-6 * len(page):.1f} MB)")
    return 0
