"""Location of a scene's parts in files: file and line."""

from __future__ import annotations

import ast
import importlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, TypeAlias

from softsim_core.scene.io.loaders import Item, Steps
from softsim_core.scene.io.yaml_source import relative_to_file

MOST_PLACES: Final = 5000
"""In larger files, only some parts are found."""

Place: TypeAlias = tuple[str, int]
"""A file, and a line in it, counted from 1."""


def places_of(file: Path) -> dict[str, Place]:
    """Return the location of every part of a file by its steps: "joints/servo_0/base"; "" is the scene.

    The files that it extends are included. In a Python file only the scene itself is found, at its
    `create_scene`; what cannot be read is at line 1.
    """
    if file.suffix == ".py":
        try:
            tree = ast.parse(file.read_bytes())
        except (OSError, ValueError, SyntaxError):
            return {"": (str(file), 1)}
        functions = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
        return {"": (str(file), next((each.lineno for each in functions if each.name == "create_scene"), 1))}
    yaml = importlib.import_module("yaml")
    found: dict[str, Place] = {"": (str(file), 1)}
    visited, at = set[Path](), file
    while at not in visited:
        visited.add(at)
        try:
            root = yaml.compose(at.read_text(encoding="utf-8"), Loader=yaml.SafeLoader)
        except (OSError, ValueError, yaml.YAMLError):
            break
        _note(root, "", at, found)
        target = _values(root).get("extends")
        if target is None:
            break
        at = relative_to_file(str(target[1].value), at)
    return found


def place_of(places: Mapping[str, Place], steps: Steps) -> Place | None:
    """Return the most specific location of a part in a result of `places_of`; None: nothing was found."""
    names = [step.name if isinstance(step, Item) else step for step in steps]
    for count in range(len(names), -1, -1):
        if (place := places.get("/".join(names[:count]))) is not None:
            return place
    return None


def _note(node: Any, path: str, file: Path, found: dict[str, Place]) -> None:
    """Add the parts of a YAML node that are not found yet: keys of mappings, named items of lists."""
    if len(found) > MOST_PLACES:
        return
    if getattr(node, "id", "") == "sequence":
        items = [
            (_values(each)["name"][1].value, each, each) for each in node.value if "name" in _values(each)
        ]
        parts = [(name, key, value) for name, key, value in items if isinstance(name, str)]
    else:
        parts = [(name, key, value) for name, (key, value) in _values(node).items()]
    for name, key, value in parts:
        below = f"{path}/{name}" if path else name
        found.setdefault(below, (str(file), key.start_mark.line + 1))
        _note(value, below, file, found)


def _values(node: Any) -> dict[str, tuple[Any, Any]]:
    """Return keys and values of a mapping node, by the keys' text; empty for another node."""
    pairs = node.value if getattr(node, "id", "") == "mapping" else []
    return {key.value: (key, value) for key, value in pairs if isinstance(key.value, str)}
