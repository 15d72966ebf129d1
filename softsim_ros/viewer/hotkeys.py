"""Keys of a robot's file as hotkeys of the page (with Ctrl) and as buttons."""

from __future__ import annotations

from typing import Final

from softsim_core.scene.control import KeyBinding
from softsim_core.scene.robot import RobotDescription
from softsim_ros.keys.names import KeyPress
from softsim_ros.keys.table import key_table

CTRL: Final = "cmd/ctrl"

_NAMED: Final = {
    "up": "arrowup",
    "down": "arrowdown",
    "left": "arrowleft",
    "right": "arrowright",
    "space": "space",
    "tab": "tab",
    "enter": "enter",
    "escape": "escape",
    "backspace": "backspace",
    "delete": "delete",
}


def page_keys(robot: RobotDescription) -> dict[str, KeyBinding]:
    """The bindings a page offers: all of the robot's but those that end a program."""
    return {name: binding for name, binding in key_table(robot).items() if binding.action != "quit"}


def hotkeys(name: str) -> list[tuple[str, str]]:
    """Key and modifier of every way to press Ctrl and the key `name` in a browser."""
    if name == "plus":  # of the keypad; on a US keyboard with shift, and without
        return [("plus", CTRL), ("plus", f"{CTRL}+shift"), ("=", CTRL)]
    if name == "minus":
        return [("minus", CTRL)]
    return [(_NAMED.get(name, name.upper()), CTRL)]


def key_label(name: str, binding: KeyBinding) -> str:
    """Words of a key's button: "Ctrl+Up: servo 0 up"."""
    return f"{KeyPress(name, ctrl=True)}: {binding.help}"
