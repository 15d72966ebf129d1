"""Single edits of a scene's file: set a value, or remove a key or an item."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol, TypeAlias

from softsim_core.base import ConfigError, listing
from softsim_core.scene.io import Item, KeyPath, Steps, key_path, shorten

EDITED_KEYS: Final = (
    "dt",
    "gravity",
    "solver",
    "bodies",
    "joints",
    "attachments",
    "rigid_bodies",
    "collisions",
    "contact",
    "effector",
    "sensors",
    "poses",
    "keys",
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
    """Remove a key of a mapping, or an item of a list.

    Attributes:
        steps: From the scene to it.
    """

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

    Args:
        tree: Mapping of the file, plain or of a reader that preserves comments.
        edit: The change.
        maker: Factory of the new parts of the tree.

    Raises:
        ConfigError: the steps lead through another type, or to nothing that could be removed.
    """
    steps = edit.steps
    _check_steps(steps)
    if isinstance(edit, Put):
        _check_value(edit.value, _format_steps(steps), MOST_DEPTH)
    at = tree
    for number, step in enumerate(steps[:-1]):
        at = _below(at, step, steps[number + 1], _format_steps(steps[: number + 1]), maker)
    last, where = steps[-1], _format_steps(steps)
    if isinstance(edit, Put):
        _put_value(at, last, edit.value, where, maker)
    else:
        _remove(at, last, where)


def _check_steps(steps: Steps) -> None:
    if not 0 < len(steps) <= MOST_STEPS or steps[0] not in EDITED_KEYS:
        raise ConfigError(
            "edit", _format_steps(steps), f"is nothing that edits change; they change {listing(EDITED_KEYS)}"
        )


def _check_value(value: Any, where: str, depth: int) -> None:
    """Reject values that no file can contain, and NaN."""
    if depth > 0 and isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        for key, each in value.items():
            _check_value(each, f"{where}.{key}", depth - 1)
    elif depth > 0 and isinstance(value, list | tuple):
        for number, each in enumerate(value):
            _check_value(each, f"{where}[{number}]", depth - 1)
    elif not (value is None or isinstance(value, str | bool | int | float)) or value != value:  # NaN
        raise ConfigError(
            "edit", where, "is no value that a file can hold; give text, numbers, lists or mappings"
        )


def _below(at: Any, step: str | Item, following: str | Item, where: str, maker: Maker) -> Any:
    """Return the value one step further; create it if it does not exist."""
    if isinstance(step, Item):
        index = index_of(at, step.name, where)
        if index is None:
            at.append(maker.make_node({"name": step.name}))
            index = len(at) - 1
        return maker.own(at, index)
    _need_mapping(at, where)
    if at.get(step) is None:
        at[step] = [] if isinstance(following, Item) else {}
    return maker.own(at, step)


def _put_value(at: Any, last: str | Item, value: Any, where: str, maker: Maker) -> None:
    if isinstance(last, Item):
        index = index_of(at, last.name, where)
        if index is None:
            at.append(maker.make_node(value))
        else:
            at[index] = overwrite_value(maker.own(at, index), value, maker)
        return
    _need_mapping(at, where)
    at[last] = overwrite_value(maker.own(at, last), value, maker) if last in at else maker.make_node(value)


def _remove(at: Any, last: str | Item, where: str) -> None:
    if isinstance(last, Item):
        index = index_of(at, last.name, where)
        if index is not None:
            del at[index]
            return
    else:
        _need_mapping(at, where)
        if last in at:
            del at[last]
            return
    raise ConfigError("edit", where, "is not written in this file, so it cannot be taken out of it")


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


def index_of(items: Any, name: str, where: str) -> int | None:
    """Return the index of the item of this name in a list; None: there is none.

    Raises:
        ConfigError: it is no list.
    """
    if not isinstance(items, list):
        raise ConfigError("edit", where, "is no list of items with names")
    named = [each.get("name") if isinstance(each, dict) else None for each in items]
    return named.index(name) if name in named else None


def _need_mapping(at: Any, where: str) -> None:
    if not isinstance(at, dict):
        raise ConfigError("edit", where, "lies in something that is no mapping")


def _format_steps(steps: Sequence[str | Item]) -> str:
    """Format steps as in joints.cable.limits."""
    names = (step.name if isinstance(step, Item) else step for step in steps[:MOST_STEPS])
    path: KeyPath = tuple(shorten(name) for name in names)
    return key_path(path)
