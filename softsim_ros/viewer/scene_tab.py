"""The tab Scene: chooser of robots and scenes, the tree of parts, properties that can be changed."""

from __future__ import annotations

import html
from collections.abc import Callable, Mapping
from typing import Any
from urllib.parse import quote

from softsim_core.scene.overrides import laid_over, read_overrides, write_overrides
from softsim_core.scene.robot import RobotDescription
from softsim_ros.client.simulator import Simulator
from softsim_ros.viewer.panel import Inbox
from softsim_ros.viewer.part_panel import PartPanel
from softsim_ros.viewer.part_tree import PartTree
from softsim_ros.viewer.picture import Picture
from softsim_ros.viewer.properties import Part, parts_of


def joint_at(path: str) -> str | None:
    """The joint that a path of the tree leads to or into, if any."""
    steps = path.split("/")
    return steps[2] if len(steps) > 2 and steps[1] == "joints" else None


class SceneTab:
    """What the scene is made of, and other scenes.

    Args:
        gui: viser's controls, inside the tab.
        inbox: Where events of browsers go.
        picture: Shows the scene, and knows what the simulator tells of it.
        simulator: Loads another scene and lays changes over this one.
        say: Called with one sentence for the person.
        is_local: Whether only browsers of this machine see the page.
    """

    def __init__(
        self,
        gui: Any,
        inbox: Inbox,
        picture: Picture,
        simulator: Simulator,
        say: Callable[[str], None],
        *,
        is_local: bool,
    ) -> None:
        self._gui, self._inbox, self._picture, self._simulator = gui, inbox, picture, simulator
        self._say, self._is_local = say, is_local
        self._folder = gui.add_folder(None)
        self._content: list[Any] = []
        self._selected = picture.robot.name
        self.show(picture.robot)

    def show(self, robot: RobotDescription) -> None:
        """Show another scene, or the same one with changes; the selected part stays, where there is one."""
        for handle in self._content:
            handle.remove()
        gui, picture = self._gui, self._picture
        self._parts = parts_of(robot)
        with self._folder:
            self._content = self._chooser()
            self._panel = PartPanel(gui, self._inbox, self._apply_changes, self._say)
            self._tree = PartTree(
                gui, self._inbox, self._parts, robot.shown_parts, self._select, picture.hide
            )
            self._content += [self._panel.folder, self._tree.folder, *self._changes(picture.overrides)]
        self._select(self._selected if self._selected in self._parts else robot.name)

    def refresh(self) -> None:
        """Show which parts are hidden."""
        self._tree.show_hidden(self._picture.view.hidden)

    def _chooser(self) -> list[Any]:
        """A list of all robots and scenes."""
        known, name = self._picture.scenes, self._picture.robot.name
        if not known:
            return []
        chooser = self._gui.add_dropdown(
            "Robot or scene",
            known,
            initial_value=name if name in known else known[0],
            hint="runs in place of this one",
        )
        self._inbox.on_change(chooser, self._simulator.choose_scene)
        return [chooser]

    def _changes(self, changes: str) -> list[Any]:
        """What is laid over the scene's file, how to keep it, and how to be rid of it."""
        if not changes:
            return []
        gui, folder = self._gui, self._gui.add_folder("Changes")
        with folder:
            words = f"Laid over it; to keep it, write it into the file:<pre>{html.escape(changes)}</pre>"
            gui.add_html(f'<div style="font-size:0.85em;padding:0 0.7em">{words}</div>')
            self._inbox.on_click(gui.add_button("Forget changes"), self._forget_changes)
        return [folder]

    def _apply_changes(self, changes: Mapping[str, Any]) -> None:
        """Have the scene begin anew with more values laid over its file."""
        wanted = laid_over(read_overrides(self._picture.overrides), changes)
        self._simulator.parameters.set("overrides", write_overrides(wanted))

    def _forget_changes(self) -> None:
        """Have the scene begin anew as its file says."""
        self._simulator.parameters.set("overrides", "")

    def _select(self, path: str) -> None:
        self._selected = path
        self._picture.base.choose(joint_at(path))
        self._panel.show(self._parts[path], self._source_text(self._parts[path]))

    def _source_text(self, part: Part) -> str:
        """Where a part is written; on this machine with a link that opens an editor there."""
        found = self._picture.place(part.steps or ())
        if found is None:
            return ""
        file, line = found
        place = f"From <code style='word-break:break-all'>{html.escape(f'{file}:{line}')}</code>"
        if not self._is_local:
            return place
        link = html.escape(f"vscode://file{quote(file)}:{line}")
        return f'{place} <a href="{link}">open in VS Code</a>'
