"""Mapping between a description's fields and the keys of a scene's file, where the names differ."""

from __future__ import annotations

import functools
import typing
from dataclasses import Field, fields
from types import MappingProxyType
from typing import Any, Final

_IN_FILE = "in_file"

BESIDE: Final = MappingProxyType({_IN_FILE: "beside"})
"""Metadata of a field with a description whose keys are on the same level as those of its owner."""

ABSENT: Final = MappingProxyType({_IN_FILE: "absent"})
"""Metadata of a field that files do not contain."""


def is_beside(field: Field[Any]) -> bool:
    """Return whether the keys of a field's value are on the same level as the keys of its owner."""
    return field.metadata.get(_IN_FILE) == "beside"


def is_absent(field: Field[Any]) -> bool:
    """Return whether files do not contain the field."""
    return field.metadata.get(_IN_FILE) == "absent"


hints_of = functools.cache(typing.get_type_hints)
"""Types of a description's fields by name."""


@functools.cache
def beside(cls: type) -> dict[str, type]:
    """Return the fields of a description with keys on the same level as its own, with their types."""
    return {each.name: hints_of(cls)[each.name] for each in fields(cls) if is_beside(each)}


@functools.cache
def keys_of(cls: type) -> tuple[str, ...]:
    """Return the keys of a description in a file, in the order of the fields."""
    inner = beside(cls)
    keys: list[str] = []
    for each in fields(cls):
        if not is_absent(each):
            keys += keys_of(inner[each.name]) if each.name in inner else (each.name,)
    return tuple(keys)
