"""A scene's file during editing: its text with comments, undo and redo.

ruamel.yaml reads and writes the text with its comments, in its own layout. Only the lines that the edits
change are taken from its output; all other lines stay as they are, byte for byte. The result is read again
and compared with the same edits on plain data.
"""

from __future__ import annotations

import importlib
import io
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from difflib import SequenceMatcher
from pathlib import Path
from typing import Any, Final, NamedTuple

from softsim_core.base import ConfigError
from softsim_core.scene import RobotDescription
from softsim_core.scene.editing.edits import Edit, Maker, carried_out
from softsim_core.scene.io import load_yaml, parse_yaml, plain_copy, relative_to_file

MOST_CHARACTERS: Final = 400_000
"""A longer file cannot be edited."""

FLOW_VALUES: Final = 8
"""Largest number of values of a new mapping or list that is written on one line."""


def apply_edits(text: str, edits: Sequence[Edit], file: Path) -> str:
    """Return a file's text after some edits.

    Raises:
        ConfigError: an edit fits nowhere, the file is too long, or an alias shares the edited part.
    """
    if len(text) > MOST_CHARACTERS:
        raise ConfigError(file, "", f"is longer than {MOST_CHARACTERS} characters; edit it by hand")

    def carry_out(tree: Any, maker: Maker) -> None:
        for edit in edits:
            carried_out(tree, edit, maker)

    return _apply_change(text, file, carry_out)


def rebase_paths(text: str, file: Path, files: Collection[Path]) -> str:
    """Return a file's text for another folder: relative paths that lead to one of `files` become absolute.

    Raises:
        ConfigError: as `apply_edits`.
    """

    def rebase(tree: Any, maker: Maker) -> None:
        for key, value in list(tree.items() if isinstance(tree, dict) else enumerate(tree)):
            if isinstance(value, dict | list):
                rebase(value, maker)
            elif isinstance(value, str) and relative_to_file(value, file) in files:
                tree[key] = str(relative_to_file(value, file))

    return _apply_change(text, file, rebase)


def _apply_change(text: str, file: Path, change: Callable[[Any, Maker], None]) -> str:
    """Apply a change to the text and to plain data, and check that both agree."""
    expected = plain_copy(parse_yaml(text, file))
    change(expected, _Plain())
    writer = _Writer(text, file)
    before = writer.to_text()
    change(writer.tree, writer)
    after = writer.to_text()
    for result in (taken_over(text, before, after), after):
        with suppress(ConfigError):
            if plain_copy(parse_yaml(result, file)) == expected:
                return result
    problem = "writes what is edited in a way that cannot be kept (an alias, or a merge key); edit it by hand"
    raise ConfigError(file, "", problem)


class _Plain:
    """Maker of plain data, in which nothing is shared."""

    def make_node(self, value: Any) -> Any:
        return plain_copy(value)

    def own(self, at: Any, key: Any) -> Any:
        return at[key]


class _Writer:
    """A text as ruamel's tree, which is changed and written again."""

    def __init__(self, text: str, file: Path) -> None:
        try:
            yaml = importlib.import_module("ruamel.yaml")
        except ImportError as error:
            raise ConfigError(file, "", "editing needs ruamel.yaml: pip install ruamel.yaml") from error
        self._comments = importlib.import_module("ruamel.yaml.comments")
        self._strings = importlib.import_module("ruamel.yaml.scalarstring")
        self._yaml = yaml.YAML()
        self._yaml.Representer = type("Representer", (yaml.representer.RoundTripRepresenter,), {})
        self._yaml.Representer.add_representer(float, _float)
        self._yaml.preserve_quotes, self._yaml.width = True, 100_000
        outdented = any(line.startswith("- ") for line in text.splitlines())
        self._yaml.indent(mapping=2, sequence=2 if outdented else 4, offset=0 if outdented else 2)
        try:
            self.tree = self._yaml.load(text)
        except yaml.error.YAMLError as error:
            problem = f"cannot be edited ({type(error).__name__}); edit it by hand"
            raise ConfigError(file, "", problem) from error

    def to_text(self) -> str:
        stream = io.StringIO()
        self._yaml.dump(self.tree, stream)
        return stream.getvalue()

    def make_node(self, value: Any) -> Any:
        """Convert plain data to nodes: small ones on one line."""
        if isinstance(value, Mapping):
            pairs = {self._quote_ambiguous_text(key): self.make_node(each) for key, each in value.items()}
            node = self._comments.CommentedMap(pairs)
        elif isinstance(value, list | tuple):
            node = self._comments.CommentedSeq([self.make_node(each) for each in value])
        else:
            return self._quote_ambiguous_text(value)
        if _count(value) <= FLOW_VALUES:
            node.fa.set_flow_style()
        else:
            node.fa.set_block_style()
        return node

    def own(self, at: Any, key: Any) -> Any:
        """Return the value of a key; if an alias or a merge key shares it, replace it by a copy first."""
        found: Any = at[key]
        is_map = isinstance(at[key], dict)
        if (is_map or isinstance(at[key], list)) and _holders(self.tree, found) > 1:
            copy = self._comments.CommentedMap(found) if is_map else self._comments.CommentedSeq(found)
            if found.fa.flow_style():
                copy.fa.set_flow_style()
            at[key] = found = copy
        return found

    def _quote_ambiguous_text(self, value: Any) -> Any:
        """Quote text that YAML 1.1 reads as another type (number, truth value, date); keep other values."""
        if isinstance(value, str):
            yaml = importlib.import_module("yaml")
            tag: str = yaml.SafeLoader("").resolve(yaml.ScalarNode, value, (True, False))
            if not tag.endswith(":str"):
                return self._strings.DoubleQuotedScalarString(value)
        return value


def _holders(tree: Any, part_of: Any) -> int:
    """Return the number of places of an object in a tree."""
    count, visited, left = 0, set[int](), [tree]
    while left:
        at = left.pop()
        if id(at) in visited:
            continue
        visited.add(id(at))
        for part in at.values() if isinstance(at, dict) else at:
            count += part is part_of
            if isinstance(part, dict | list):
                left.append(part)
    return count


def _float(representer: Any, value: float) -> Any:
    """Represent a number as YAML 1.1 requires it: with a decimal point."""
    mantissa, mark, exponent = repr(value).partition("e")
    if not mark:
        return representer.represent_float(value)
    point = "" if "." in mantissa else ".0"
    return representer.represent_scalar("tag:yaml.org,2002:float", f"{mantissa}{point}e{exponent}")


def _count(value: Any) -> int:
    """Return the number of single values in plain data."""
    if isinstance(value, Mapping):
        return sum(map(_count, value.values()))
    return sum(map(_count, value)) if isinstance(value, list | tuple) else 1


def taken_over(text: str, before: str, after: str) -> str:
    """Apply the changes from `before` to `after` to `text`, which has the same content as `before`."""
    own, base, new = (each.splitlines(keepends=True) for each in (text, before, after))
    if own and not own[-1].endswith("\n"):
        own[-1] += "\n"
    place = {
        block.a + k: block.b + k
        for block in SequenceMatcher(None, base, own, autojunk=False).get_matching_blocks()
        for k in range(block.size)
    }
    result, done = list[str](), 0
    for begin, end, lines in _hunks(base, new, place):
        first = 0 if begin == 0 else place[begin - 1] + 1
        last = len(own) if end == len(base) else place[end]
        replaced = own[first:last]
        while not replaced and lines and first > done:
            line = own[first - 1]
            if line.strip() and not (_is_remark(line) and _indent(line) < _indent(lines[0])):
                break
            first -= 1  # insert before empty lines, and before less indented comments on the following lines
        moved = own[first:last] if not replaced else _remarks_after(replaced, lines)
        result += [*own[done:first], *lines, *moved]
        done = last
    return "".join([*result, *own[done:]])


def _hunks(base: list[str], new: list[str], place: Mapping[int, int]) -> list[tuple[int, int, list[str]]]:
    """Return differences of `new`: begin and end in `base`, at lines with a `place`, and new lines."""
    found: list[tuple[int, int, int, int]] = []
    for tag, a, b, c, d in SequenceMatcher(None, base, new, autojunk=False).get_opcodes():
        if tag == "equal":
            continue
        while a > 0 and a - 1 not in place:
            a, c = a - 1, c - 1
        while b < len(base) and b not in place:
            b, d = b + 1, d + 1
        if found and a <= found[-1][1]:
            a, c = found[-1][0], found[-1][2]
            found.pop()
        found.append((a, b, c, d))
    return [(a, b, new[c:d]) for a, b, c, d in found]


def _remarks_after(replaced: list[str], lines: list[str]) -> list[str]:
    """Return comments at the end of removed lines: they belong to the following lines, and stay."""
    remarks: list[str] = []
    for line in reversed(replaced):
        if not (_is_remark(line) or not line.strip()) or (lines and line == lines[-1]):
            break
        remarks.insert(0, line)
    return remarks


def _is_remark(line: str) -> bool:
    return line.lstrip().startswith("#")


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip())


MOST_UNDONE: Final = 500
"""Number of changes that can be undone."""


class Proposal(NamedTuple):
    """A file's text, and the scene that it describes."""

    text: str
    robot: RobotDescription


class SceneDocument:
    """The text of a scene's YAML file with edits; nothing is written to disk here.

    Every change is checked like a loaded file. A change that does not yield a scene is rejected and has no
    effect.

    Attributes:
        file: The file.
        saved: Its content as far as it is known here, at first `text`.

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
        """The proposed text of the file."""
        return self._states[self._at].text

    @property
    def robot(self) -> RobotDescription:
        """The robot described by the proposed text."""
        return self._states[self._at].robot

    @property
    def is_changed(self) -> bool:
        """Whether the proposal differs from the file."""
        return self.text != self.saved

    @property
    def undoable(self) -> int:
        """Number of changes that can be undone."""
        return self._at

    @property
    def redoable(self) -> int:
        """Number of undone changes that can be redone."""
        return len(self._states) - 1 - self._at

    def propose(self, edits: Sequence[Edit]) -> Proposal:
        """Return the result of `change` without applying it.

        Raises:
            ConfigError: as `change`.
        """
        text = apply_edits(self.text, edits, self.file)
        robot = load_yaml(self.file, text=text)
        if robot.name != self.robot.name:
            raise ConfigError(self.file, "name", "cannot be edited while the robot runs; it is its namespace")
        return Proposal(text, robot)

    def change(self, edits: Sequence[Edit], stroke: str = "") -> None:
        """Apply edits, which are undone together.

        Args:
            edits: The changes, in this order.
            stroke: Consecutive changes with the same stroke, such as those of a dragged handle, are undone
                together; empty: this one is undone alone.

        Raises:
            ConfigError: they fit nowhere, or the result is no scene; nothing has changed.
        """
        self.take(self.propose(edits), stroke)

    def take(self, proposal: Proposal, stroke: str = "") -> None:
        """Make a result of `propose` the current proposal."""
        if proposal.text == self.text:
            return
        goes_on = bool(stroke) and stroke == self._stroke and self._at == len(self._states) - 1 > 0
        del self._states[self._at + (not goes_on) :]
        self._states.append(proposal)
        del self._states[: max(0, len(self._states) - 1 - MOST_UNDONE)]
        self._at, self._stroke = len(self._states) - 1, stroke

    def note_saved(self) -> None:
        """Record that the proposal was saved to its file."""
        self.saved = self.text

    def undo(self) -> bool:
        """Undo the last change; return whether there was one."""
        return self._move(-1)

    def redo(self) -> bool:
        """Redo the last undone change; return whether there was one."""
        return self._move(1)

    def _move(self, steps: int) -> bool:
        there = 0 <= self._at + steps < len(self._states)
        if there:
            self._at += steps
        self._stroke = ""
        return there
