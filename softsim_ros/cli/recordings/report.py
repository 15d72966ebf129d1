"""`softsim report BAG`: write charts and the moving picture of a recording into one web page."""

from __future__ import annotations

import argparse
import importlib.util
import sys
from pathlib import Path

from softsim_core.base import install_command


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("bag", type=Path, help="folder of a recording, or an .mcap or .db3 file")
    parser.add_argument("-o", "--out", type=Path, metavar="HTML", help="where to write (BAG_report.html)")


def run(arguments: argparse.Namespace) -> int:
    """Write the page."""
    if importlib.util.find_spec("matplotlib") is None:
        print(f"softsim report: charts need matplotlib; {install_command('report')}", file=sys.stderr)
        return 1
    from softsim_ros import write_page
    from softsim_ros.recording import Bag, report

    bag_path = arguments.bag.resolve()
    file = arguments.out or bag_path.with_name(f"{bag_path.stem}_report.html")
    with Bag(arguments.bag) as bag:
        page = report(bag)
    write_page(file, page)
    print(f"{file}: open it in a browser ({1e-6 * len(page):.1f} MB)")
    return 0
