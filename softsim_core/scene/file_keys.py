"""How a description's fields stand in a scene's file, where that is not under a key of the field's name."""

from __future__ import annotations

import functools
import typing
from dataclasses import Field, fields
from types import MappingProxyType
from typing import Any, Final

_IN_FILE = "in_file"

BESIDE: Final = MappingProxyType({_IN_FILE: "beside"})
"""Metadata of a field that holds a description: its keys stand beside those of the owner's other fields."""

ABSENT: Final = MappingProxyType({_IN_FILE: "absent"})
"""Metadata of a field that no file gives."""


def is_beside(field: Field[Any]) -> bool:
    """Whether the keys of what the field holds stand beside the keys of its owner."""
    return field.metadata.get(_IN_FILE) == "beside"


def is_absent(field: Field[Any]) -> bool:
    """Whether no file gives the field."""
    return field.metadata.get(_IN_FILE) == "absent"


@functools.cache
def beside(cls: type) -> dict[str, type]:
    """The fields of a description whose keys stand beside its own, with what they hold."""
    named = [each.name for each in fields(cls) if is_beside(each)]
    hints = typing.get_type_hints(cls) if named else {}
    return {name: hints[name] for name in named}


@functools.cache
def keys_of(cls: type) -> tuple[str, ...]:
    """The keys with which a file gives a description, in the order of the fields."""
    inner = beside(cls)
    keys: list[str] = []
    for each in fields(cls):
        if not is_absent(each):
            keys += keys_of(inner[each.name]) if each.name in inner else (each.name,)
    return tuple(keys)
