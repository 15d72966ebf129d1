"""A ROS message as indented text, long arrays shortened."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from typing import Any


def message_text(message: Any, limit: int | None = 12, indent: str = "") -> str:
    """Fields of a message, one a line, nested messages indented.

    Args:
        message: Any ROS message.
        limit: Longest array that is printed whole; None prints all.
        indent: Put before every line.
    """
    lines = []
    for name in message.get_fields_and_field_types():
        value = getattr(message, name)
        if hasattr(value, "get_fields_and_field_types"):
            lines += [f"{indent}{name}:", message_text(value, limit, f"{indent}  ")]
        elif _is_list(value) and len(value) and hasattr(value[0], "get_fields_and_field_types"):
            shown = value if limit is None else value[:limit]
            lines.append(f"{indent}{name}:")
            lines += [_item(item, limit, indent) for item in shown]
            if len(shown) < len(value):
                lines.append(f"{indent}  ... {len(value)} in all")
        else:
            lines.append(f"{indent}{name}: {_value_text(value, limit)}")
    return "\n".join(lines)


def _item(item: Any, limit: int | None, indent: str) -> str:
    text = message_text(item, limit, f"{indent}    ")
    return f"{indent}  - {text.lstrip()}"


def _is_list(value: Any) -> bool:
    return isinstance(value, (Sequence, array)) and not isinstance(value, (str, bytes))


def _value_text(value: Any, limit: int | None) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, (str, bytes)) or not hasattr(value, "__len__"):
        return str(value)
    shown = value if limit is None else value[:limit]
    text = ", ".join(_value_text(item, limit) for item in shown)
    rest = f", ... {len(value)} in all" if len(shown) < len(value) else ""
    return f"[{text}{rest}]"
