"""A scene's file while it is edited: its text as it is proposed, with undo and redo."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

from softsim_core.editing.edits import Edit
from softsim_core.editing.round_trip import edited
from softsim_core.errors import ConfigError
from softsim_core.scene.robot import RobotDescription
from softsim_core.scene.yaml_loader import load_yaml

MOST_UNDONE: Final = 500
"""So many changes can be undone."""


class Proposal(NamedTuple):
    """A file's text, and the scene that it describes."""

    text: str
    robot: RobotDescription


class SceneDocument:
    """The text of a scene's YAML file, changed by edits; nothing is written here.

    Every change is checked as a file is that is loaded: one that describes no scene is refused and changes
    nothing.

    Args:
        file: The file.
        text: What it holds now.

    Attributes:
        file: The file.
        saved: What it holds, as far as it is known here.

    Raises:
        ConfigError: the text describes no scene.
    """

    def __init__(self, file: Path, text: str) -> None:
        self.file, self.saved = file, text
        self._states = [Proposal(text, load_yaml(file, text=text))]
        self._at = 0
        self._stroke = ""

    @property
    def text(self) -> str:
        """The file as it is proposed."""
        return self._states[self._at].text

    @property
    def robot(self) -> RobotDescription:
        """The scene of that text."""
        return self._states[self._at].robot

    @property
    def is_changed(self) -> bool:
        """Whether the proposal differs from the file."""
        return self.text != self.saved

    @property
    def undoable(self) -> int:
        """How many changes can be undone."""
        return self._at

    @property
    def redoable(self) -> int:
        """How many changes that were undone can be done again."""
        return len(self._states) - 1 - self._at

    def proposed(self, edits: Sequence[Edit]) -> Proposal:
        """What `change` would make of it.

        Raises:
            ConfigError: as `change`.
        """
        text = edited(self.text, edits, self.file)
        robot = load_yaml(self.file, text=text)
        if robot.name != self.robot.name:
            raise ConfigError(self.file, "name", "cannot be edited while the robot runs; it is its namespace")
        return Proposal(text, robot)

    def change(self, edits: Sequence[Edit], stroke: str = "") -> None:
        """Carry out edits, which are undone together.

        Args:
            edits: What to change, in this order.
            stroke: Changes in a row with the same stroke, such as those of a handle that is dragged, are
                undone together; empty: this one is undone alone.

        Raises:
            ConfigError: they fit nowhere, or what they make is no scene; nothing has changed.
        """
        self.take(self.proposed(edits), stroke)

    def take(self, proposal: Proposal, stroke: str = "") -> None:
        """Go on with what `proposed` returned."""
        if proposal.text == self.text:
            return
        goes_on = bool(stroke) and stroke == self._stroke and self._at == len(self._states) - 1 > 0
        del self._states[self._at + (not goes_on) :]
        self._states.append(proposal)
        del self._states[: max(0, len(self._states) - 1 - MOST_UNDONE)]
        self._at, self._stroke = len(self._states) - 1, stroke

    def note_saved(self, file: Path | None = None) -> None:
        """The proposal was written into its file, or into another one, which is edited from now on."""
        self.file, self.saved = file or self.file, self.text

    def undo(self) -> bool:
        """Take the last change back; whether there was one."""
        return self._move(-1)

    def redo(self) -> bool:
        """Do what was undone last again; whether there was something."""
        return self._move(1)

    def _move(self, steps: int) -> bool:
        there = 0 <= self._at + steps < len(self._states)
        if there:
            self._at += steps
        self._stroke = ""
        return there
