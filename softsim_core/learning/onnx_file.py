"""What an ONNX file asks for, read from its bytes before a runtime allocates or opens anything.

A file of a few hundred bytes can name other files to read (external data), a constant of any size, and
functions that unfold to any number of nodes. Only the fields that say so are read; onnx.proto numbers them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from types import MappingProxyType
from typing import Final, Literal, TypeAlias

Kind: TypeAlias = Literal["model", "training", "graph", "node", "attribute", "tensor", "sparse tensor"]

_PARTS: Final = MappingProxyType[Kind, dict[int, Kind]](
    {
        "model": {7: "graph", 20: "training"},
        "training": {1: "graph", 2: "graph"},
        "graph": {1: "node", 5: "tensor", 15: "sparse tensor"},
        "node": {5: "attribute"},
        "attribute": {
            5: "tensor", 6: "graph", 10: "tensor", 11: "graph", 22: "sparse tensor", 23: "sparse tensor",
        },
        "sparse tensor": {1: "tensor", 2: "tensor"},
        "tensor": {},
    }
)  # fmt: skip
"""Messages inside of messages, by field."""

_ONCE: Final = frozenset({("model", 7), ("attribute", 5), ("attribute", 6), ("attribute", 22),
                          ("sparse tensor", 1), ("sparse tensor", 2)})  # fmt: skip
"""Fields that may stand once: of two, a reader would make one constant of the sizes of both."""

_DIMENSIONS: Final = MappingProxyType({"tensor": 1, "sparse tensor": 3})
_DATA_TYPE, _EXTERNAL_DATA, _DATA_LOCATION, _FUNCTIONS = 2, 13, 14, 25
_BYTES: Final = MappingProxyType({1: 4, 2: 1, 3: 1, 4: 2, 5: 2, 6: 4, 9: 1, 10: 2, 12: 4, 8: 32, 15: 16})
"""Bytes of a number by data type, where it is not 8; of a text at least."""


def objection(data: bytes, most_bytes: int) -> str:
    """Why a model is not to be loaded, as "it reads other files ..."; empty: it may be.

    Args:
        data: The file.
        most_bytes: Memory that all its constants together may take.
    """
    total = 0
    waiting: list[tuple[Kind, memoryview]] = [("model", memoryview(data))]
    try:
        while waiting:
            kind, message = waiting.pop()
            dimensions, width, found = [], 8, set()
            for field, value in _fields(message):
                part = _PARTS[kind].get(field)
                if part is not None and isinstance(value, memoryview):
                    if field in found and (kind, field) in _ONCE:
                        return f"a field of its {kind} stands there twice"
                    found.add(field)
                    waiting.append((part, value))
                elif kind == "model" and field == _FUNCTIONS:
                    return (
                        "it defines functions of its own; inline them (onnx.inliner.inline_local_functions)"
                    )
                elif kind == "tensor" and (
                    field == _EXTERNAL_DATA or (field == _DATA_LOCATION and value != 0)
                ):
                    return "it keeps constants in other files (external data); save it as one file"
                elif field == _DIMENSIONS.get(kind):
                    dimensions += _integers(value)
                elif kind == "tensor" and field == _DATA_TYPE and isinstance(value, int):
                    width = _BYTES.get(value, 8)
            if kind in _DIMENSIONS:
                total += width * math.prod(dimensions)
                if total > most_bytes:
                    return f"its constants take {total} bytes or more; at most {most_bytes} are allowed"
    except (IndexError, ValueError):
        return "it is no ONNX file that ONNX Runtime can run (damaged)"
    return ""


def _fields(message: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """Number and value of each field: an integer, or bytes.

    Raises:
        ValueError, IndexError: the bytes are no such message.
    """
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        wire = key & 7
        if wire == 0:
            value, at = _varint(message, at)
            yield key >> 3, value
            continue
        if wire == 2:
            size, at = _varint(message, at)
        else:
            size = {1: 8, 5: 4}.get(wire, len(message) + 1)
        if at + size > len(message):
            raise ValueError(wire)
        yield key >> 3, message[at : at + size]
        at += size


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    value = 0
    for place in range(10):
        byte = message[at + place]
        value |= (byte & 0x7F) << 7 * place
        if byte < 0x80:
            return value, at + place + 1
    raise ValueError(value)


def _integers(value: int | memoryview) -> list[int]:
    """One integer, or those packed into bytes."""
    if isinstance(value, int):
        return [value]
    found, at = [], 0
    while at < len(value):
        number, at = _varint(value, at)
        found.append(number)
    return found
