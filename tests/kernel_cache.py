"""Compiled kernels for a copy of the package: Numba's cache of these tests, where the copy looks for it."""

from __future__ import annotations

import hashlib
import os
import shutil
from pathlib import Path

from softsim_core import warmup

REPOSITORY = Path(__file__).resolve().parents[1]


def copy_kernels(folder: Path) -> None:
    """Give the package `softsim_core` in `folder` what is compiled here; its files get the times of these."""
    for package in {cache.parents[1] for cache in REPOSITORY.glob("softsim_core/**/__pycache__/kernels-*")}:
        copy = folder / package.relative_to(REPOSITORY)
        for source in package.glob("*.py"):
            seen = source.stat()
            os.utime(copy / source.name, ns=(seen.st_atime_ns, seen.st_mtime_ns))
        place = hashlib.sha1(str(copy).encode()).hexdigest()
        for kernels in {index.parent for index in package.glob("__pycache__/kernels-*/**/*.nbi")}:
            name = f"{kernels.name.rpartition('_')[0]}_{place}"
            shutil.copytree(kernels, copy / kernels.relative_to(package).with_name(name), dirs_exist_ok=True)
    here, there = warmup._mark(), warmup._mark(folder / "softsim_core")
    if here is not None and there is not None and here.is_file() and here.is_relative_to(REPOSITORY):
        (folder / here.relative_to(REPOSITORY)).with_name(there.name).touch()
