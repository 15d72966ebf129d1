"""Single edits of a scene's file: set a value, or remove a key or an item."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol, TypeAlias

from softsim_core.base import ConfigError, listing, shorten
from softsim_core.scene.io import Item, Steps, key_path

EDITED_KEYS: Final = (
    *("dt", "gravity", "solver", "bodies", "joints", "attachments", "rigid_bodies", "collisions", "contact"),
    *("effector", "sensors", "poses", "keys"),
)
"""Top-level keys of a scene's file that edits may change; name, board and the like may not be edited."""

MOST_STEPS: Final = 12
MOST_DEPTH: Final = 8
"""Largest nesting depth of values."""


@dataclass(frozen=True, slots=True)
class Put:
    """Set a value, whether or not one exists; see `carried_out`.

    Attributes:
        steps: From the scene to the value; an `Item` that a list does not contain is appended to it.
        value: Plain data as in a file.
    """

    steps: Steps
    value: Any


@dataclass(frozen=True, slots=True)
class Remove:
    """Remove a key of a mapping, or an item of a list, by the steps from the scene to it."""

    steps: Steps


Edit: TypeAlias = "Put | Remove"


class Maker(Protocol):
    """Factory of the parts of a tree."""

    def make_node(self, value: Any) -> Any:
        """Convert plain data to a part of the tree."""

    def own(self, at: Any, key: Any) -> Any:
        """Return the value of a key in a mapping or list, unshared by any alias."""


def carried_out(tree: Any, edit: Edit, maker: Maker) -> None:
    """Apply an edit to a file's data, in place.

    Unchanged parts stay the same objects, which preserves their comments: mappings are changed key by key and
    lists item by item, not replaced.

    `tree` is the mapping of the file, plain or of a reader that preserves comments; `maker` makes new parts.

    Raises:
        ConfigError: the steps lead through another type, or to nothing that could be removed.
    """
    steps = edit.steps
    if not 0 < len(steps) <= MOST_STEPS or steps[0] not in EDITED_KEYS:
        problem = f"is nothing that edits change; they change {listing(EDITED_KEYS)}"
        raise ConfigError("edit", _format_steps(steps), problem)
    if isinstance(edit, Put):
        _check_value(edit.value, _format_steps(steps), MOST_DEPTH)
    at = tree
    for number, step in enumerate(steps[:-1]):
        key = _key_of(at, step, _format_steps(steps[: number + 1]))
        if key is None and isinstance(step, Item):
            at.append(maker.make_node({"name": step.name}))
            key = len(at) - 1
        elif not isinstance(step, Item) and at.get(step) is None:
            key = step
            at[step] = [] if isinstance(steps[number + 1], Item) else {}
        at = maker.own(at, key)
    where = _format_steps(steps)
    key = _key_of(at, steps[-1], where)
    if isinstance(edit, Remove):
        if key is None:
            problem = "is not written in this file, so it cannot be taken out of it"
            raise ConfigError("edit", where, problem)
        del at[key]
    elif key is not None:
        at[key] = overwrite_value(maker.own(at, key), edit.value, maker)
    elif isinstance(at, list):
        at.append(maker.make_node(edit.value))
    else:
        at[steps[-1]] = maker.make_node(edit.value)


def _check_value(value: Any, where: str, depth: int) -> None:
    """Reject values that no file can contain, and NaN."""
    if depth > 0 and isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        for key, each in value.items():
            _check_value(each, f"{where}.{key}", depth - 1)
    elif depth > 0 and isinstance(value, list | tuple):
        for number, each in enumerate(value):
            _check_value(each, f"{where}[{number}]", depth - 1)
    elif not (value is None or isinstance(value, str | bool | int | float)) or value != value:  # NaN
        problem = "is no value that a file can hold; give text, numbers, lists or mappings"
        raise ConfigError("edit", where, problem)


def overwrite_value(old: Any, new: Any, maker: Maker) -> Any:
    """Change `old` in place to the content of `new`; replace it if that is impossible."""
    if isinstance(old, dict) and isinstance(new, Mapping):
        for key in [key for key in old if key not in new]:
            del old[key]
        for key, value in new.items():
            old[key] = (
                overwrite_value(maker.own(old, key), value, maker) if key in old else maker.make_node(value)
            )
        return old
    if isinstance(old, list) and isinstance(new, list | tuple):
        for index, value in enumerate(new[: len(old)]):
            old[index] = overwrite_value(maker.own(old, index), value, maker)
        del old[len(new) :]
        old.extend(maker.make_node(value) for value in new[len(old) :])
        return old
    return old if type(new) is not bool and old == new and not isinstance(old, bool) else maker.make_node(new)


def _key_of(at: Any, step: str | Item, where: str) -> Any:
    """Return the index or key of a step in a list of named items or a mapping; None: it is not there."""
    if isinstance(step, Item):
        if not isinstance(at, list):
            raise ConfigError("edit", where, "is no list of items with names")
        named = [each.get("name") if isinstance(each, dict) else None for each in at]
        return named.index(step.name) if step.name in named else None
    if not isinstance(at, dict):
        raise ConfigError("edit", where, "lies in something that is no mapping")
    return step if step in at else None


def _format_steps(steps: Sequence[str | Item]) -> str:
    """Format steps as in joints.cable.limits."""
    names = (step.name if isinstance(step, Item) else step for step in steps[:MOST_STEPS])
    return key_path(shorten(name) for name in names)
