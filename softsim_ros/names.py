"""Names in the ROS graph."""

from __future__ import annotations

import re


def ros_name(name: str) -> str:
    """A scene's name as a ROS namespace: letters, digits and underscores, not beginning with a digit."""
    cleaned = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return f"_{cleaned}" if not cleaned or cleaned[0].isdigit() else cleaned
