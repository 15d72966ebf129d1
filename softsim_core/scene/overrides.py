"""Changes that are laid over a scene's file: as text, one over another, and of single fields."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

from softsim_core.scene.plain import sourced
from softsim_core.scene.yaml_source import merge, parse_yaml

ORIGIN = Path("overrides")
"""What messages name instead of a file."""


class Item(NamedTuple):
    """A step from a list to its item of this name."""

    name: str


Steps: TypeAlias = "tuple[str | Item, ...]"
"""From the scene to one of its parts: ("joints", Item("servo_0"), "base")."""


def override_at(steps: Sequence[str | Item], values: Mapping[str, Any]) -> dict[str, Any]:
    """Values for the fields of one part, as `load_scene` takes them."""
    data: Any = dict(values)
    for step in reversed(steps):
        data = [{"name": step.name, **data}] if isinstance(step, Item) else {step: data}
    return {**data}


def read_overrides(text: str) -> dict[str, Any]:
    """Overrides from YAML text; empty text is none.

    Raises:
        ConfigError: no YAML, or no mapping.
    """
    return parse_yaml(text, ORIGIN) if text.strip() else {}


def write_overrides(overrides: Mapping[str, Any]) -> str:
    """Overrides as YAML text, which `read_overrides` reads and a scene's file may hold; "" for none."""
    if not overrides:
        return ""
    yaml = importlib.import_module("yaml")
    return str(yaml.safe_dump(_plain(overrides), sort_keys=False, default_flow_style=None, width=100))


def laid_over(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """`above` laid over `below` by the rules of scenes: mappings and lists of named items merge."""
    merged: dict[str, Any] = _plain(merge(sourced(below, ORIGIN), sourced(above, ORIGIN)))
    return merged


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value
