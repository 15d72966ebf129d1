"""The parts of a scene with their properties and help texts, from the descriptions themselves."""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from softsim_core.scene.description import SceneDescription
from softsim_core.scene.overrides import Item

_LISTS = ("bodies", "joints", "attachments", "rigid_bodies", "collisions")
"""Lists of parts, which are properties only where they are empty."""

_SKIPPED = ("name", "keys", "controllers", "source")


@dataclass(frozen=True)
class Part:
    """One part of a scene.

    Attributes:
        path: Where it stands in the tree, such as "bodies/silicone".
        help: What it is, one sentence or two.
        properties: Name, value as text, and help of each property.
        steps: Where it stands in the scene's file; None for an item of a list without names.
        editable: Values by name of the properties that a person may change: plain ones.
    """

    path: str
    help: str
    properties: tuple[tuple[str, str, str], ...]
    steps: tuple[str | Item, ...] | None = ()
    editable: Mapping[str, Any] = field(default_factory=dict)


def parts_of(scene: SceneDescription) -> dict[str, Part]:
    """Every part of a scene by its path, the scene itself first."""
    found: dict[str, Part] = {}
    _visit(scene, scene.name, (), found)
    return found


def _visit(value: Any, path: str, steps: tuple[str | Item, ...] | None, found: dict[str, Part]) -> None:
    """Add a description and the descriptions in it."""
    summary, helps = documentation(type(value))
    rows: list[tuple[str, str, str]] = []
    inner: list[tuple[str, tuple[str | Item, ...] | None, Any]] = []
    editable: dict[str, Any] = {}
    for described in dataclasses.fields(value):
        content = getattr(value, described.name)
        if described.name in _SKIPPED:
            continue
        below = f"{path}/{described.name}"
        there = None if steps is None else (*steps, described.name)
        if dataclasses.is_dataclass(content):
            inner.append((below, there, content))
        elif isinstance(content, tuple) and content and dataclasses.is_dataclass(content[0]):
            for i, each in enumerate(content):
                name = getattr(each, "name", None)
                item = None if there is None or name is None else (*there, Item(name))
                inner.append((f"{below}/{name or getattr(each, 'joint', i)}", item, each))
        else:
            rows.append((described.name, value_text(content), helps.get(described.name, "")))
            if steps is not None and described.name not in _LISTS and _is_plain(content):
                editable[described.name] = content
    found[path] = Part(path, summary, tuple(rows), steps, editable)
    for below, there, content in inner:
        _visit(content, below, there, found)


def _is_plain(value: Any) -> bool:
    """Whether a value can be written by hand."""
    if isinstance(value, tuple):
        return all(map(_is_plain, value))
    return value is None or isinstance(value, bool | int | float | str)


def value_text(value: Any) -> str:
    """A value for a person."""
    if value is None:
        return "none"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, tuple):
        return ", ".join(map(value_text, value)) or "none"
    if isinstance(value, Mapping):
        return "; ".join(f"{key}: {value_text(each)}" for key, each in value.items()) or "none"
    if hasattr(value, "shape"):
        return f"array {tuple(value.shape)}"
    return str(value)


def documentation(kind: type) -> tuple[str, dict[str, str]]:
    """First paragraph of a class's docstring, and the texts of its attributes by name."""
    text = inspect.getdoc(kind) or ""
    summary = " ".join(text.split("\n\n")[0].split())
    section = re.search(r"^Attributes:\n(.*?)(?=^\S|\Z)", text, re.DOTALL | re.MULTILINE)
    helps: dict[str, str] = {}
    if section:
        body = inspect.cleandoc(section.group(1))
        for match in re.finditer(r"^([\w, ]+): (.*?)(?=^\S|\Z)", body, re.DOTALL | re.MULTILINE):
            for name in match.group(1).split(","):
                helps[name.strip()] = " ".join(match.group(2).split())
    return summary, helps
