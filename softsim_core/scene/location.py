"""Where a part of a scene is written: file and line."""

from __future__ import annotations

import ast
import importlib
from pathlib import Path
from typing import Any

from softsim_core.scene.overrides import Item, Steps
from softsim_core.scene.yaml_source import relative_to_file


def locate(file: Path, steps: Steps) -> tuple[Path, int]:
    """File and line, from 1 on, where a part stands.

    Args:
        file: The scene's file.
        steps: From the scene to the part.

    Returns:
        The file that says most of it: this one, or one that it extends. A Python file at its `create_scene`;
        line 1 where nothing of it is found.
    """
    if file.suffix == ".py":
        return file, _line_of_function(file)
    found, seen, at = (file, 0, 1), set[Path](), file
    while at not in seen:
        seen.add(at)
        root = _root(at)
        depth, line = _walk(root, steps)
        if depth > found[1]:
            found = (at, depth, line)
        target = _values(root).get("extends")
        if target is None or depth == len(steps):
            break
        at = relative_to_file(str(target[1].value), at)
    return found[0], found[2]


def _walk(node: Any, steps: Steps) -> tuple[int, int]:
    """How many steps lead on from a node of YAML's, and the line where the last of them stands."""
    line = 1
    for depth, step in enumerate(steps):
        if isinstance(step, Item):
            items = node.value if isinstance(node.value, list) else []
            named = [each for each in items if "name" in _values(each)]
            node = next((each for each in named if _values(each)["name"][1].value == step.name), None)
            key = node
        else:
            key, node = _values(node).get(step, (None, None))
        if node is None:
            return depth, line
        line = key.start_mark.line + 1
    return len(steps), line


def _values(node: Any) -> dict[str, tuple[Any, Any]]:
    """Keys and values of a mapping node, by the keys' text; of another node none."""
    pairs = node.value if getattr(node, "id", "") == "mapping" else []
    return {key.value: (key, value) for key, value in pairs if isinstance(key.value, str)}


def _root(file: Path) -> Any:
    """The root node of a YAML file; None where it cannot be read."""
    yaml = importlib.import_module("yaml")
    try:
        return yaml.compose(file.read_text(encoding="utf-8"), Loader=yaml.SafeLoader)
    except (OSError, ValueError, yaml.YAMLError):
        return None


def _line_of_function(file: Path) -> int:
    try:
        tree = ast.parse(file.read_bytes())
    except (OSError, ValueError, SyntaxError):
        return 1
    functions = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
    return next((each.lineno for each in functions if each.name == "create_scene"), 1)
