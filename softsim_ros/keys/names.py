"""Names of keys, as terminals and browsers send them and a robot's file binds them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class KeyPress:
    """One key, plain or with Ctrl.

    Attributes:
        name: One of `softsim_core.scene.control.KEY_NAMES`: "up", "plus", "space", a lower-case letter, a
            digit, a punctuation character.
        ctrl: Ctrl (or Cmd) was held. Tab is Ctrl+I on every terminal.
    """

    name: str
    ctrl: bool = False

    def __str__(self) -> str:
        label = self.name.replace("_", " ").capitalize() if len(self.name) > 1 else self.name
        return f"Ctrl+{label.capitalize()}" if self.ctrl else label
