"""Names of frames that follow from the namespace of a robot."""

from __future__ import annotations


def prefix_of(namespace: str) -> str:
    """The prefix of a robot's frames: its namespace and a slash, such as "left/"; empty for the root."""
    name = namespace.strip("/")
    return f"{name}/" if name else ""
