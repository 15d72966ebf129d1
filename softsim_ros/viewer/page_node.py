"""What the controls of the page show and do: a commander with a picture and diagnostics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from softsim_core.scene.overrides import laid_over, read_overrides, write_overrides
from softsim_ros.viewer.commander import Commander
from softsim_ros.viewer.diagnostics_link import DiagnosticsLink
from softsim_ros.viewer.picture import Picture


class PageNode(Commander):
    """The node behind the page, as its controls know it.

    Attributes:
        picture: What is drawn.
        diagnostics: What the nodes tell of themselves.
        scene_name: Name of the scene that is shown.
        efforts: Torque in [N m] or force in [N] of each joint, in joint order; empty while unknown.
        is_local: Whether only browsers of this machine see the page.
    """

    picture: Picture
    diagnostics: DiagnosticsLink
    scene_name: str
    efforts: Sequence[float]
    is_local: bool

    def apply_overrides(self, changes: Mapping[str, Any]) -> None:
        """Have the scene begin anew with more values laid over its file."""
        wanted = laid_over(read_overrides(self.picture.overrides), changes)
        self.parameters.set("overrides", write_overrides(wanted))

    def clear_overrides(self) -> None:
        """Have the scene begin anew as its file says."""
        self.parameters.set("overrides", "")
