"""Compiled kernels for a copy of the package: those of this checkout, which have the same content."""

from __future__ import annotations

from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]


def share_kernels(folder: Path) -> None:
    """Let the package `softsim_core` in a folder use what is compiled here, and keep there what it adds."""
    for kernels in REPOSITORY.glob("softsim_core/**/__pycache__/kernels-*"):
        place = folder / kernels.relative_to(REPOSITORY)
        place.parent.mkdir(exist_ok=True)
        place.symlink_to(kernels)
