"""Message classes by the names that the graph and bags use."""

from __future__ import annotations

import importlib


def load_message(type_name: str) -> type:
    """The class of a type such as "sensor_msgs/msg/JointState".

    Raises:
        ImportError, AttributeError: its package is not installed, or has no such type.
    """
    package, _, name = type_name.split("/")
    loaded: type = getattr(importlib.import_module(f"{package}.msg"), name)
    return loaded
