"""Random messages of any ROS type: values that mean something, values that cannot be, damaged bytes."""

from __future__ import annotations

import importlib
import math
import operator
import random
import re
from collections.abc import Sequence
from typing import Any

NUMBERS = (0.0, -0.0, 1e-300, 1e-9, 0.01, 1.0, -1.0, 179.0, 1e6, 1e18, -1e308, math.inf, -math.inf, math.nan)
LENGTHS = (0, 0, 1, 2, 3, 3, 3, 4, 7, 100, 3000)
BITS = re.compile(r"(u?)int(\d+)")


PARTS = {
    **{each: each for each in ("Goal", "Feedback")},
    **{each: f"Impl.{each}Service" for each in ("SendGoal", "GetResult")},
}
"""Where rclpy keeps the parts of an action, by the ends of their types' names."""


def loaded(name: str) -> Any:
    """The class of an interface such as std_msgs/msg/String, or of a part of an action."""
    package, kind, type_name = name.split("/")
    action, _, part = type_name.rpartition("_")
    if part in PARTS:
        path = f"{action}.{PARTS[part]}"
        return operator.attrgetter(path)(importlib.import_module(f"{package}.action"))
    return getattr(importlib.import_module(f"{package}.{kind}"), type_name)


class Mutations:
    """Draws messages.

    Args:
        seed: Of the random numbers.
        texts: Strings that a message may hold: names that mean something, paths that nobody may open.
    """

    def __init__(self, seed: int, texts: Sequence[str]) -> None:
        self.random, self._texts = random.Random(seed), list(texts)

    def message(self, message_type: Any, depth: int = 0) -> Any:
        """A message of that class with random fields."""
        made = message_type()
        for field, kind in message_type.get_fields_and_field_types().items():
            if self.random.random() < 0.85:
                setattr(made, field, self._value(kind, depth))
        return made

    def damaged(self, serialized: bytes) -> bytes:
        """The bytes of a message with some changed, or an end cut off; the first four name the encoding."""
        data = bytearray(serialized)
        if self.random.random() < 0.4:
            return bytes(data[: self.random.randint(4, max(4, len(data)))])
        for _ in range(self.random.choice((1, 2, 8))):
            if len(data) > 4:
                data[self.random.randrange(4, len(data))] = self.random.choice((0, 1, 127, 128, 255))
        return bytes(data)

    def text(self) -> str:
        return self.random.choice(self._texts)

    def number(self) -> float:
        return self.random.choice((*NUMBERS, self.random.uniform(-3.0, 3.0)))

    def _value(self, kind: str, depth: int) -> Any:
        sequence = re.fullmatch(r"sequence<(.+?)(?:, (\d+))?>", kind)
        array = re.fullmatch(r"(.+)\[(\d+)\]", kind)
        if sequence or array:
            inner = (sequence or array).group(1)  # type: ignore[union-attr]
            if array:
                length = int(array.group(2))
            else:
                length = min(self.random.choice(LENGTHS), 20 if "/" in inner else 3000)
            length = min(length, 2) if depth > 2 else length
            return [self._value(inner, depth + 1) for _ in range(length)]
        bits = BITS.fullmatch(kind)
        if kind in ("boolean", "bool"):
            return self.random.random() < 0.5
        if kind in ("double", "float"):
            number = self.number()
            return number if kind == "double" or not math.isfinite(number) else max(-3e38, min(3e38, number))
        if kind.startswith("string"):
            return self.text()
        if kind in ("octet", "byte"):
            return bytes([self.random.randrange(256)])
        if bits:
            size = int(bits.group(2))
            low, high = (0, 2**size - 1) if bits.group(1) else (-(2 ** (size - 1)), 2 ** (size - 1) - 1)
            return max(
                low, min(high, self.random.choice((0, 1, 2, 3, 9, low, high, self.random.randint(low, high))))
            )
        return self.message(loaded(kind.replace("/", "/msg/") if kind.count("/") == 1 else kind), depth + 1)
