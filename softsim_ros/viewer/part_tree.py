"""The tree of a scene's parts: branches that open and close, a switch and a button for each part."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any

from softsim_ros.viewer.panel import Control, Inbox
from softsim_ros.viewer.properties import Part


class PartTree:
    """Folders in folders, closed at first but for the scene itself.

    Args:
        gui: viser's controls, where the tree goes.
        inbox: Where events of browsers go.
        parts: The parts by path, each after the one it belongs to.
        shown_parts: Those of them (paths without the scene's name) that can be hidden.
        on_select: Called with the path of a part whose properties a person wants to see.
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
        """The folder of the scene itself, around all others."""
        return next(iter(self._folders.values()))

    def show_hidden(self, hidden: Collection[str]) -> None:
        """Show which parts are hidden."""
        for part, control in self._switches.items():
            control.show(part not in hidden)

    def _add(self, path: str) -> None:
        """A part's folder with its switch and its button."""
        with self._folder(path):
            part = path.partition("/")[2]
            if part in self._shown_parts:
                box = self._gui.add_checkbox("Shown", True)
                self._switches[part] = self._inbox.on_change(
                    box, lambda shown: self._on_hide(part, not shown)
                )
            self._inbox.on_click(self._gui.add_button("Show properties"), lambda: self._on_select(path))

    def _folder(self, path: str) -> Any:
        """The folder of a path, made with those above it."""
        if path not in self._folders:
            above, _, name = path.rpartition("/")
            if above:
                with self._folder(above):
                    self._folders[path] = self._gui.add_folder(name, expand_by_default=False)
            else:
                self._folders[path] = self._gui.add_folder(name)
        return self._folders[path]
