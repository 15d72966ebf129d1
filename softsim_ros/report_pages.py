"""Web pages of reports: templates filled with values, as single files that fetch nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from softsim_core.base import DataError, write_file


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
