"""A scene's file while it is edited: its text with comments kept, undo and redo.

ruamel.yaml reads and writes the text with its comments, in its own layout. Of what it writes only those lines
are taken that the edits change; all others are the file's own, byte for byte. What comes out is read again
and compared with the edits carried out on plain data.
"""

from __future__ import annotations

import importlib
import io
from collections.abc import Callable, Collection, Mapping, Sequence
from difflib import SequenceMatcher
from pathlib import Path
from typing import Any, Final, NamedTuple

from softsim_core.base import ConfigError
from softsim_core.scene import RobotDescription
from softsim_core.scene.editing.edits import Edit, Maker, carried_out
from softsim_core.scene.io import load_yaml, parse_yaml, relative_to_file

MOST_CHARACTERS: Final = 400_000
"""A longer file is not edited."""

FLOW_VALUES: Final = 8
"""A new mapping or list with at most so many values in it stands on one line."""


def edited(text: str, edits: Sequence[Edit], file: Path) -> str:
    """A file's text after some edits.

    Raises:
        ConfigError: an edit fits nowhere, the file is too long, or an alias shares what is edited.
    """
    if len(text) > MOST_CHARACTERS:
        raise ConfigError(file, "", f"is longer than {MOST_CHARACTERS} characters; edit it by hand")

    def carry_out(tree: Any, maker: Maker) -> None:
        for edit in edits:
            carried_out(tree, edit, maker)

    return _changed(text, file, carry_out)


def rebased(text: str, file: Path, files: Collection[Path]) -> str:
    """A file's text for another folder: relative paths in it that lead to one of `files` become absolute.

    Raises:
        ConfigError: as `edited`.
    """

    def absolute(value: Any) -> Any:
        if isinstance(value, str) and relative_to_file(value, file) in files:
            return str(relative_to_file(value, file))
        return value

    def rebase(tree: Any, maker: Maker) -> None:
        for key, value in list(tree.items() if isinstance(tree, dict) else enumerate(tree)):
            if isinstance(value, dict | list):
                rebase(value, maker)
            elif absolute(value) != value:
                tree[key] = absolute(value)

    return _changed(text, file, rebase)


def _changed(text: str, file: Path, change: Callable[[Any, Maker], None]) -> str:
    """A text after a change, which is carried out on plain data, too, and has to come to the same."""
    expected = _unshared(parse_yaml(text, file))
    change(expected, _Plain())
    writer = _Writer(text, file)
    before = writer.written()
    change(writer.tree, writer)
    after = writer.written()
    for result in (taken_over(text, before, after), after):
        if _reads_as(result, expected, file):
            return result
    raise ConfigError(
        file,
        "",
        "writes what is edited in a way that cannot be kept (an alias, or a merge key); edit it by hand",
    )


class _Plain:
    """Makes parts of plain data, of which nothing is shared."""

    def made(self, value: Any) -> Any:
        return _unshared(value)

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
            raise ConfigError(
                file, "", f"cannot be edited ({type(error).__name__}); edit it by hand"
            ) from error

    def written(self) -> str:
        """The tree as text."""
        stream = io.StringIO()
        self._yaml.dump(self.tree, stream)
        return stream.getvalue()

    def made(self, value: Any) -> Any:
        """Plain data as nodes: small ones on one line."""
        if isinstance(value, Mapping):
            pairs = {self._quoted(key): self.made(each) for key, each in value.items()}
            node = self._comments.CommentedMap(pairs)
        elif isinstance(value, list | tuple):
            node = self._comments.CommentedSeq([self.made(each) for each in value])
        else:
            return self._quoted(value)
        if _count(value) <= FLOW_VALUES:
            node.fa.set_flow_style()
        else:
            node.fa.set_block_style()
        return node

    def own(self, at: Any, key: Any) -> Any:
        """What is under a key; where an alias or a merge key shares it, a copy takes its place."""
        found: Any = at[key]
        is_map = isinstance(at[key], dict)
        if (is_map or isinstance(at[key], list)) and _holders(self.tree, found) > 1:
            copy = self._comments.CommentedMap(found) if is_map else self._comments.CommentedSeq(found)
            if found.fa.flow_style():
                copy.fa.set_flow_style()
            at[key] = found = copy
        return found

    def _quoted(self, value: Any) -> Any:
        """Text that would be read as something else in quotes; other values as they are."""
        if isinstance(value, str) and _is_misread(value):
            return self._strings.DoubleQuotedScalarString(value)
        return value


def _holders(tree: Any, wanted: Any) -> int:
    """In how many places of a tree something stands."""
    count, seen, left = 0, set[int](), [tree]
    while left:
        at = left.pop()
        if id(at) in seen:
            continue
        seen.add(id(at))
        for part in at.values() if isinstance(at, dict) else at:
            count += part is wanted
            if isinstance(part, dict | list):
                left.append(part)
    return count


def _is_misread(text: str) -> bool:
    """Whether YAML 1.1 takes bare text for something else: a number, a truth value, a date, nothing."""
    yaml = importlib.import_module("yaml")
    loader = yaml.SafeLoader("")
    tag: str = loader.resolve(yaml.ScalarNode, text, (True, False))
    return not tag.endswith(":str")


def _float(representer: Any, value: float) -> Any:
    """A number as YAML 1.1 takes it for one: with a point in it."""
    mantissa, mark, exponent = repr(value).partition("e")
    if not mark:
        return representer.represent_float(value)
    point = "" if "." in mantissa else ".0"
    return representer.represent_scalar("tag:yaml.org,2002:float", f"{mantissa}{point}e{exponent}")


def _count(value: Any) -> int:
    """How many single values some plain data hold."""
    if isinstance(value, Mapping):
        return sum(map(_count, value.values()))
    return sum(map(_count, value)) if isinstance(value, list | tuple) else 1


def taken_over(text: str, before: str, after: str) -> str:
    """The changes from `before` to `after` carried over to `text`, which says what `before` says."""
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
        while not replaced and lines and first > done and _is_beside(own[first - 1], lines[0]):
            first -= 1  # what is added stands before the remarks on what follows
        moved = own[first:last] if not replaced else _remarks_after(replaced, lines)
        result += [*own[done:first], *lines, *moved]
        done = last
    return "".join([*result, *own[done:]])


def _hunks(base: list[str], new: list[str], place: Mapping[int, int]) -> list[tuple[int, int, list[str]]]:
    """Where `new` differs: begin and end in `base`, both by lines with a `place`, and what stands there."""
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
    """Remarks at the end of lines that go: they are about what follows, and stay."""
    kept: list[str] = []
    for line in reversed(replaced):
        if not (_is_remark(line) or not line.strip()) or (lines and line == lines[-1]):
            break
        kept.insert(0, line)
    return kept


def _is_beside(line: str, added: str) -> bool:
    """Whether a line is a remark, or empty, and stands further out than what is added after it."""
    return not line.strip() or (_is_remark(line) and _indent(line) < _indent(added))


def _is_remark(line: str) -> bool:
    return line.lstrip().startswith("#")


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip())


def _reads_as(text: str, expected: Any, file: Path) -> bool:
    try:
        return bool(_unshared(parse_yaml(text, file)) == expected)
    except ConfigError:
        return False


def _unshared(value: Any) -> Any:
    """Plain data without parts in common."""
    if isinstance(value, Mapping):
        return {key: _unshared(each) for key, each in value.items()}
    return [_unshared(each) for each in value] if isinstance(value, list | tuple) else value


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
