"""The tree of a scene's parts, and the properties of each."""

from __future__ import annotations

import dataclasses
import html
import importlib
import inspect
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from softsim_core.base import ConfigError
from softsim_core.physics.actuation import ActuatorDescription
from softsim_core.scene import MaterialDescription, RobotDescription, is_beside
from softsim_core.scene.io import Item, override_at, read_overrides, write_overrides
from softsim_ros.nodes.viewer.panel import Control, Inbox

_LISTS = ("bodies", "joints", "attachments", "rigid_bodies", "collisions", "sensors")
"""Lists of parts; they are shown as properties only where they are empty."""

_SKIPPED = ("name", "keys", "controllers", "source")


@dataclass(frozen=True)
class Part:
    """One part of a scene.

    Attributes:
        path: Path in the tree, such as "bodies/silicone".
        help: Description of one or two lines.
        properties: Name, value as text, and help of each property.
        steps: Position in the scene's file; None for an item of a list without names.
        editable: Values by name of the properties that the user may change: plain ones.
    """

    path: str
    help: str
    properties: tuple[tuple[str, str, str], ...]
    steps: tuple[str | Item, ...] | None = ()
    editable: Mapping[str, Any] = field(default_factory=dict)


def parts_of(robot: RobotDescription) -> dict[str, Part]:
    """Return every part of a scene by its path, the scene itself first."""
    found: dict[str, Part] = {}
    _visit(robot, robot.name, (), found)
    return found


def _visit(value: Any, path: str, steps: tuple[str | Item, ...] | None, found: dict[str, Part]) -> None:
    """Add a description and its nested descriptions to `found`."""
    summary = documentation(type(value))[0]
    rows: list[tuple[str, str, str]] = []
    inner: list[tuple[str, tuple[str | Item, ...] | None, Any]] = []
    editable: dict[str, Any] = {}
    for key, content, text in _contents(value):
        if key in _SKIPPED:
            continue
        below = f"{path}/{key}"
        there = None if steps is None else (*steps, key)
        if dataclasses.is_dataclass(content) or isinstance(content, MaterialDescription):
            inner.append((below, there, content))
        elif isinstance(content, tuple) and content and dataclasses.is_dataclass(content[0]):
            for i, each in enumerate(content):
                name = getattr(each, "name", None)
                item = None if there is None or name is None else (*there, Item(name))
                inner.append((f"{below}/{name or getattr(each, 'joint', i)}", item, each))
        else:
            rows.append((key, value_text(content), text))
            if steps is not None and key not in _LISTS and _is_plain(content):
                editable[key] = content
    found[path] = Part(path, summary, tuple(rows), steps, editable)
    for below, there, content in inner:
        _visit(content, below, there, found)


def _contents(value: Any) -> Iterator[tuple[str, Any, str]]:
    """Yield key in files, content and help of each field, also of descriptions that files write beside it."""
    if isinstance(value, MaterialDescription):
        for parameter in value.law_for("polar").parameters:
            unit = "" if parameter.unit == "-" else f" in {parameter.unit}"
            text = f"{parameter.description}{unit}, {parameter.allowed}"
            yield parameter.name, value.values[parameter.name], text
        return
    helps = documentation(type(value))[1]
    for described in dataclasses.fields(value):
        content = getattr(value, described.name)
        if is_beside(described):
            yield from _contents(content)
        elif isinstance(content, ActuatorDescription):
            yield content.kind, content, ""
        elif described.name != "actuator":
            yield described.name, content, helps.get(described.name, "")


def _is_plain(value: Any) -> bool:
    """Return whether a value can be edited as text."""
    if isinstance(value, tuple):
        return all(map(_is_plain, value))
    return value is None or isinstance(value, bool | int | float | str)


def value_text(value: Any) -> str:
    """Return a value as text for the user."""
    if value is None:
        return "none"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, tuple):
        return ", ".join(map(value_text, value)) or "none"
    if isinstance(value, Mapping):
        return "; ".join(f"{key}: {value_text(each)}" for key, each in value.items()) or "none"
    if hasattr(value, "shape"):
        return f"array {tuple(value.shape)}"
    return str(value)


def documentation(kind: type) -> tuple[str, dict[str, str]]:
    """Return the first paragraph of a class's docstring, and the texts of its attributes by name."""
    text = inspect.getdoc(kind) or ""
    summary = " ".join(text.split("\n\n")[0].split())
    section = re.search(r"^Attributes:\n(.*?)(?=^\S|\Z)", text, re.DOTALL | re.MULTILINE)
    helps: dict[str, str] = {}
    if section:
        body = inspect.cleandoc(section.group(1))
        for match in re.finditer(r"^([\w, ]+): (.*?)(?=^\S|\Z)", body, re.DOTALL | re.MULTILINE):
            for name in match.group(1).split(","):
                helps[name.strip()] = " ".join(match.group(2).split())
    return summary, helps


class PartPanel:
    """A folder that shows one part at a time.

    `on_change` is called with the overrides of the scene that the user requests, see `load_scene`.
    """

    def __init__(
        self,
        gui: Any,
        inbox: Inbox,
        on_change: Callable[[Mapping[str, Any]], None],
        say: Callable[[str], None],
    ) -> None:
        self._gui, self._inbox, self._on_change, self._say = gui, inbox, on_change, say
        self.folder = gui.add_folder("Properties")
        self._content: list[Any] = []
        self._fields: dict[str, tuple[str, Any]] = {}

    def show(self, part: Part, source: str) -> None:
        """Show a part; `source` is HTML with its file and line."""
        for handle in self._content:
            handle.remove()
        gui = self._gui
        with self.folder:
            self._content = [gui.add_html(_table(part, source))]
            helps = {name: text for name, _, text in part.properties}
            self._fields = {}
            for name, value in part.editable.items():
                text = field_text(value)
                handle = gui.add_text(name, text, hint=helps[name] or None)
                self._fields[name] = (text, handle)
                self._content.append(handle)
            if self._fields:
                button = gui.add_button("Apply changes", hint="the scene restarts with them")
                self._inbox.on_click(button, lambda: self._apply(part))
                self._content.append(button)

    def _apply(self, part: Part) -> None:
        """Pass on the fields that the user has changed."""
        texts = {
            name: handle.value for name, (shown, handle) in self._fields.items() if handle.value != shown
        }
        try:
            values = {name: field_value(name, text) for name, text in texts.items()}
        except ConfigError as error:
            self._say(str(error))
            return
        if values and part.steps is not None:
            self._on_change(override_at(part.steps, values))
        else:
            self._say("nothing was changed")


def field_text(value: Any) -> str:
    """Return a value as it is written in a scene's file, on one line."""
    yaml = importlib.import_module("yaml")
    plain = read_overrides(write_overrides({"value": value}))["value"]  # tuples as lists
    text: str = yaml.safe_dump(plain, default_flow_style=True, width=1e9)
    return text.removesuffix("...\n").strip()


def field_value(name: str, text: str) -> Any:
    """Return the value of a text that the user entered.

    Raises:
        ConfigError: it is no YAML.
    """
    return read_overrides(f"{name}: {text}").get(name)


def _table(part: Part, source: str) -> str:
    """Return a part's description and its read-only properties as HTML."""
    rows = "".join(
        f"<tr><td>{html.escape(name)}</td><td>{html.escape(value)}</td></tr>"
        f'<tr><td colspan="2" style="opacity:0.7">{html.escape(text)}</td></tr>'
        for name, value, text in part.properties
        if name not in part.editable
    )
    title = f"<b>{html.escape(part.path)}</b>: {html.escape(part.help)}"
    return f'<div style="font-size:0.85em;padding:0 0.7em">{title}<br>{source}<table>{rows}</table></div>'


class PartTree:
    """Nested folders, closed at first except that of the scene itself.

    Args:
        gui: viser's controls, where the tree is added.
        inbox: Queue for events.
        parts: The parts by path, each after its parent.
        shown_parts: Parts that can be hidden, as paths without the scene's name.
        on_select: Called with the path of a part that the user selects.
        on_hide: Called with a path without the scene's name, and whether it is hidden from now on.
    """

    def __init__(
        self,
        gui: Any,
        inbox: Inbox,
        parts: Mapping[str, Part],
        shown_parts: Collection[str],
        on_select: Callable[[str], None],
        on_hide: Callable[[str, bool], None],
    ) -> None:
        self._gui, self._inbox = gui, inbox
        self._shown_parts, self._on_select, self._on_hide = shown_parts, on_select, on_hide
        self._folders: dict[str, Any] = {}
        self._switches: dict[str, Control] = {}
        for path in parts:
            self._add(path)

    @property
    def folder(self) -> Any:
        """Folder of the scene itself, which contains all others."""
        return next(iter(self._folders.values()))

    def show_hidden(self, hidden: Collection[str]) -> None:
        """Show which parts are hidden."""
        for part, control in self._switches.items():
            control.show(part not in hidden)

    def _add(self, path: str) -> None:
        """Add a part's folder with its switch and its button."""
        with self._folder(path):
            part = path.partition("/")[2]
            if part in self._shown_parts:
                box = self._gui.add_checkbox("Shown", True)
                self._switches[part] = self._inbox.on_change(
                    box, lambda shown: self._on_hide(part, not shown)
                )
            self._inbox.on_click(self._gui.add_button("Show properties"), lambda: self._on_select(path))

    def _folder(self, path: str) -> Any:
        """Return the folder of a path; create it and its parents if needed."""
        if path not in self._folders:
            above, _, name = path.rpartition("/")
            if above:
                with self._folder(above):
                    self._folders[path] = self._gui.add_folder(name, expand_by_default=False)
            else:
                self._folders[path] = self._gui.add_folder(name)
        return self._folders[path]
