"""Folders of ROS packages that robot files name, with and without a ROS installation."""

from __future__ import annotations

import os
from pathlib import Path


def package_folders(package: str, file: Path) -> list[Path]:
    """Where a package may be: folders of its name above a file, then below the entries of AMENT_PREFIX_PATH.

    Args:
        package: Its name.
        file: The file that names it.
    """
    above = [folder for folder in file.resolve().parents if folder.name == package]
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return above + [Path(prefix) / "share" / package for prefix in prefixes if prefix]
