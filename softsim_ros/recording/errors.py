"""Errors of recording and of reading bags."""

from __future__ import annotations

from os import PathLike

from softsim_core.base import SoftSimError


class RecordingError(SoftSimError, RuntimeError):
    """A bag cannot be written; messages written before are preserved."""


class BagError(SoftSimError, ValueError):
    """A bag cannot be read, or lacks requested data; carries its path and the reason."""

    def __init__(self, path: str | PathLike[str], reason: str) -> None:
        self.path, self.reason = str(path), reason
        super().__init__(f"bag {self.path}: {reason}")
