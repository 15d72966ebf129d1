"""Figures of Matplotlib as data and as files."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, Final

from softsim_core.base.files import write_file

_DOTS_PER_INCH: Final = 120


def figure_data(figure: Any, kind: str, **how: Any) -> bytes:
    """A figure in a format such as "png"; its texts are shown as they are, a `$` in a name is no formula.

    Raises:
        ValueError: there is no such format.
    """
    from matplotlib.text import Text

    for text in figure.findobj(Text):
        text.set_parse_math(False)
    data = io.BytesIO()
    figure.savefig(data, format=kind, **how)
    return data.getvalue()


def save_figure(figure: Any, file: Path) -> None:
    """Write a figure in the format that the file's ending names, PNG where it has none.

    Raises:
        OSError: the file cannot be written.
        ValueError: the ending names no format.
    """
    write_file(file, figure_data(figure, file.suffix[1:] or "png", dpi=_DOTS_PER_INCH))
