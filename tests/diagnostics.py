"""What a node reports on /diagnostics, for tests."""

from __future__ import annotations

from typing import Any


def diagnostic_values(message: Any, name: str) -> dict[str, str]:
    """The values of the status of that name; empty if the message has none."""
    for status in message.status:
        if status.name == name:
            return {entry.key: entry.value for entry in status.values}
    return {}
