"""The properties of one part: what it is, what it says, and fields in which a person changes it."""

from __future__ import annotations

import html
import importlib
from collections.abc import Callable, Mapping
from typing import Any

from softsim_core.errors import ConfigError
from softsim_core.scene.overrides import override_at, read_overrides, write_overrides
from softsim_ros.viewer.panel import Inbox
from softsim_ros.viewer.properties import Part


class PartPanel:
    """A folder that shows one part at a time.

    Args:
        gui: viser's controls, where the folder goes.
        inbox: Where events of browsers go.
        on_change: Called with what a person wants laid over the scene, see `load_scene`.
        say: Called with one sentence for the person.
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
        """Show a part; `source` is HTML that tells where it is written."""
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
                button = gui.add_button("Apply changes", hint="the scene begins anew with them")
                self._inbox.on_click(button, lambda: self._apply(part))
                self._content.append(button)

    def _apply(self, part: Part) -> None:
        """Hand over the fields that a person has changed."""
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
    """A value as it is written in a scene's file, on one line."""
    yaml = importlib.import_module("yaml")
    plain = read_overrides(write_overrides({"value": value}))["value"]  # tuples as lists
    text: str = yaml.safe_dump(plain, default_flow_style=True, width=1e9)
    return text.removesuffix("...\n").strip()


def field_value(name: str, text: str) -> Any:
    """The value that a person wrote.

    Raises:
        ConfigError: it is no YAML.
    """
    return read_overrides(f"{name}: {text}").get(name)


def _table(part: Part, source: str) -> str:
    """What a part is, and its properties that are not to be changed by hand."""
    rows = "".join(
        f"<tr><td>{html.escape(name)}</td><td>{html.escape(value)}</td></tr>"
        f'<tr><td colspan="2" style="opacity:0.7">{html.escape(text)}</td></tr>'
        for name, value, text in part.properties
        if name not in part.editable
    )
    title = f"<b>{html.escape(part.path)}</b>: {html.escape(part.help)}"
    return f'<div style="font-size:0.85em;padding:0 0.7em">{title}<br>{source}<table>{rows}</table></div>'
