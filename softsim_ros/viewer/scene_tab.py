"""The tab Scene: chooser of robots and scenes, the tree of parts with their properties."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from softsim_core.scene.description import SceneDescription
from softsim_core.scene.files import known_scenes
from softsim_ros.viewer.panel import Inbox
from softsim_ros.viewer.properties import parts_of

if TYPE_CHECKING:
    from softsim_ros.viewer.viewer_node import Viewer


class SceneTab:
    """What the scene is made of, and other scenes.

    Args:
        gui: viser's controls, inside the tab.
        inbox: Where events of browsers go.
        viewer: The node that loads another scene.
        robot: The scene.
    """

    def __init__(self, gui: Any, inbox: Inbox, viewer: Viewer, robot: SceneDescription) -> None:
        self._robot, self._parts = robot, parts_of(robot)
        known = tuple(known_scenes())
        if known:
            name = viewer.scene_name
            chooser = gui.add_dropdown(
                "Robot or scene",
                known,
                initial_value=name if name in known else known[0],
                hint="runs in place of this one",
            )
            inbox.on_change(chooser, viewer.choose_scene)
        tree = "\n".join(
            f"{'&nbsp;' * 4 * path.count('/')}{path.rsplit('/', 1)[-1]}  " for path in self._parts
        )
        paths = tuple(self._parts)
        part = gui.add_dropdown("Part", paths, initial_value=paths[0])
        self._properties = gui.add_markdown(self._part_text(paths[0]))
        inbox.on_change(part, self._show_part)
        with gui.add_folder("Tree", expand_by_default=False):
            gui.add_markdown(tree)

    def _show_part(self, path: str) -> None:
        self._properties.content = self._part_text(path)

    def _part_text(self, path: str) -> str:
        part = self._parts[path]
        rows = "\n".join(f"| {name} | {value} | {text} |" for name, value, text in part.properties)
        source = "" if self._robot.source is None else f"\n\nFrom `{self._robot.source}`"
        return f"**{path}**: {part.help}\n\n| | | |\n|---|---|---|\n{rows}{source}"
