"""A view as a file: a scene that differs from the one on the page by its section `view` only."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from softsim_core.scene.overrides import write_overrides
from softsim_core.scene.robot import RobotDescription
from softsim_core.scene.view import ViewSettings


def view_file(robot: RobotDescription, view: ViewSettings) -> str:
    """YAML text of a scene that shows `scene` with `view`.

    It extends the scene's own file; one in Python cannot be extended, and the text is the section alone.
    """
    own, shown = asdict(robot.view), asdict(view)
    changed = {name: value for name, value in shown.items() if value != own[name]}
    text: dict[str, Any] = {"view": changed}
    if robot.source is not None and robot.source.suffix != ".py":
        text = {"extends": str(robot.source), **text}
    return write_overrides(text)
