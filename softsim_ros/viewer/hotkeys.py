"""Keys of a robot's file as hotkeys of the page (with Ctrl) and as a table of buttons."""

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

_SIGNS: Final = {
    "up": "↑",
    "down": "↓",
    "left": "←",
    "right": "→",
    "plus": "+",
    "minus": "\N{MINUS SIGN}",
    "page_up": "PgUp",
    "page_down": "PgDn",
}
"""How a button shows its key; any other as KeyPress does."""


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


def key_rows(robot: RobotDescription) -> list[tuple[str, dict[str, str]]]:
    """The table of keys: words of each row, and in it a key's name by the words of its button.

    Keys of the same joints share a row, and so do all poses and all actions. The e-stop has buttons of its
    own, above all tabs.
    """
    groups: dict[object, list[str]] = {}
    stops = ("e_stop", "clear_e_stop")
    keys = {name: each for name, each in page_keys(robot).items() if each.action not in stops}
    for name, binding in keys.items():
        groups.setdefault(binding.joints or binding.pose is not None, []).append(name)
    rows = []
    for what, names in groups.items():
        label = "poses" if what else "actions"
        if isinstance(what, tuple):
            label = what[0].replace("_", " ") + (" ..." if len(what) > 1 else "")
        words = {name: keys[name].help.removeprefix(label).strip() for name in names}
        rows.append((label, {_button(name, each): name for name, each in words.items()}))
    return rows


def _button(name: str, words: str) -> str:
    """Words of a key's button in the table: "↑ up"."""
    label = str(KeyPress(name))
    return f"{_SIGNS.get(name, label.upper() if len(label) == 1 else label)} {words}"
