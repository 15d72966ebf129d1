"""Files of reports: web pages from templates, which fetch nothing, and pictures of Matplotlib figures."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, Final

from softsim_core.base import ConfigError, DataError, write_file

_DOTS_PER_INCH: Final = 120


def render_page(template: str, **values: Any) -> str:
    """Return a page of `templates/` as HTML; every value is escaped.

    Raises:
        ValueError: a number of the JSON data of the page is not finite.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("softsim_ros"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False}
    return environment.get_template(template).render(values)


def write_page(file: Path, page: str) -> None:
    """Write a page.

    Raises:
        DataError: the file cannot be written.
    """
    try:
        write_file(file, page)
    except OSError as error:
        raise DataError(file, "", f"cannot be written ({error.strerror})") from error


def figure_data(figure: Any, kind: str, **how: Any) -> bytes:
    """Return a figure in a format such as "png"; texts are shown literally, so a `$` starts no formula.

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
    """Write a figure in the format given by the file's suffix, or PNG if it has none.

    Raises:
        ConfigError: the file cannot be written, or the suffix names no format.
    """
    try:
        write_file(file, figure_data(figure, file.suffix[1:] or "png", dpi=_DOTS_PER_INCH))
    except (OSError, ValueError) as error:
        raise ConfigError(file, "", f"no picture was written: {error}; name a .png file") from error
