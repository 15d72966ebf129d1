"""The parts of a scene with their properties and help texts, from the descriptions themselves."""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from softsim_core.actuation import ActuatorDescription
from softsim_core.scene.file_keys import is_beside
from softsim_core.scene.material import MaterialDescription
from softsim_core.scene.overrides import Item
from softsim_core.scene.robot import RobotDescription

_LISTS = ("bodies", "joints", "attachments", "rigid_bodies", "collisions", "sensors")
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


def parts_of(robot: RobotDescription) -> dict[str, Part]:
    """Every part of a scene by its path, the scene itself first."""
    found: dict[str, Part] = {}
    _visit(robot, robot.name, (), found)
    return found


def _visit(value: Any, path: str, steps: tuple[str | Item, ...] | None, found: dict[str, Part]) -> None:
    """Add a description and the descriptions in it."""
    summary = documentation(type(value))[0]
    rows: list[tuple[str, str, str]] = []
    inner: list[tuple[str, tuple[str | Item, ...] | None, Any]] = []
    editable: dict[str, Any] = {}
    for key, content, text in _contents(value):
        if key in _SKIPPED:
            continue
        below = f"{path}/{key}"
        there = None if steps is None else (*steps, key)
        if dataclasses.is_dataclass(content) or isinstance(content, MaterialDescription):
            inner.append((below, there, content))
        elif isinstance(content, tuple) and content and dataclasses.is_dataclass(content[0]):
            for i, each in enumerate(content):
                name = getattr(each, "name", None)
                item = None if there is None or name is None else (*there, Item(name))
                inner.append((f"{below}/{name or getattr(each, 'joint', i)}", item, each))
        else:
            rows.append((key, value_text(content), text))
            if steps is not None and key not in _LISTS and _is_plain(content):
                editable[key] = content
    found[path] = Part(path, summary, tuple(rows), steps, editable)
    for below, there, content in inner:
        _visit(content, below, there, found)


def _contents(value: Any) -> Iterator[tuple[str, Any, str]]:
    """Keys of a description in files, contents and help texts; those of one that stands beside it too."""
    if isinstance(value, MaterialDescription):
        for parameter in value.law_for("polar").parameters:
            unit = "" if parameter.unit == "-" else f" in {parameter.unit}"
            text = f"{parameter.description}{unit}, {parameter.allowed}"
            yield parameter.name, value.values[parameter.name], text
        return
    helps = documentation(type(value))[1]
    for described in dataclasses.fields(value):
        content = getattr(value, described.name)
        if is_beside(described):
            yield from _contents(content)
        elif isinstance(content, ActuatorDescription):
            yield content.kind, content, ""
        elif described.name != "actuator":
            yield described.name, content, helps.get(described.name, "")


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
