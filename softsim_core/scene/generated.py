"""Foreign text in files that are generated: names of others stay names, and comments stay comments."""

from __future__ import annotations

import importlib
from typing import Final

LONGEST: Final = 500
"""Characters of a line of a comment at most."""


def comment(*lines: str) -> str:
    """Lines of a comment of YAML, Python or CSV files, whatever the texts hold."""
    return "".join(f"# {on_one_line(line)[:LONGEST]}\n" for line in lines)


def on_one_line(text: str) -> str:
    """Text without line breaks and other characters that are not printable."""
    return "".join(each if each.isprintable() else " " for each in text)


def scalar(text: str) -> str:
    """Text as YAML reads it back where a value or a key stands, on one line."""
    yaml = importlib.import_module("yaml")
    style = None if text.isprintable() else '"'
    dumped: str = yaml.safe_dump([text], default_flow_style=True, default_style=style, width=float("inf"))
    return dumped.strip()[1:-1]
