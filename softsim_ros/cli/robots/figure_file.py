"""Figures of Matplotlib as files."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, Final

from softsim_core.file_writing import write_file

_DOTS_PER_INCH: Final = 120


def save_figure(figure: Any, file: Path) -> None:
    """Write a figure in the format that the file's ending names, PNG where it has none.

    Raises:
        OSError: the file cannot be written.
        ValueError: the ending names no format.
    """
    data = io.BytesIO()
    figure.savefig(data, dpi=_DOTS_PER_INCH, format=file.suffix[1:] or "png")
    write_file(file, data.getvalue())
