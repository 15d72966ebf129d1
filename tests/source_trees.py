"""Syntax trees of source files, parsed once for all tests of a worker that look at them."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path


@cache
def tree_of(file: Path) -> ast.Module:
    """The syntax tree of a Python file; whoever gets it must not change it."""
    return ast.parse(file.read_text(encoding="utf-8"))
