#!/usr/bin/env python3
"""Write the packages as ordinary folders without links to the rest of the checkout, as bloom releases them.

    python3 ros2_ws/release_tree.py FOLDER

A checkout has each package's code at its top, and links to it here. Bloom takes a package's folder alone, so
it receives the repository that FOLDER becomes: `git init`, commit, tag, and `bloom-release`.
"""

import shutil
import sys
from pathlib import Path

SOURCE = Path(__file__).resolve().parent / "src"
LEFT_OUT = shutil.ignore_patterns("__pycache__", "*.pyc", "*.egg-info")


def write(folder: Path) -> list[Path]:
    """Copy every package with its links followed, and return the folders.

    Raises:
        FileExistsError: a package is there already.
    """
    packages = sorted(file.parent for file in SOURCE.glob("*/package.xml"))
    written = [Path(shutil.copytree(package, folder / package.name, ignore=LEFT_OUT)) for package in packages]
    for package in written:
        shutil.copy(SOURCE.parents[1] / "LICENSE", package)
        tests = package / "setup.cfg"  # the suite's tests need the whole checkout
        tests.write_text(tests.read_text().partition("[tool:pytest]")[0])
    return written


def main() -> int:
    """Write the tree that the command line names, and return the exit code."""
    if len(sys.argv) != 2:
        sys.stderr.write("usage: release_tree.py FOLDER\n")
        return 2
    try:
        written = write(Path(sys.argv[1]))
    except OSError as error:
        sys.stderr.write(f"{error}; give a folder without these packages\n")
        return 1
    sys.stdout.writelines(f"{package}\n" for package in written)
    return 0


if __name__ == "__main__":
    sys.exit(main())
