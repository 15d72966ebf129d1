"""Description of an arm, the key `arm` of a scene's file; typed, SI."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from softsim_core.base import Placement, SceneName, need_finite


@dataclass(frozen=True, slots=True, kw_only=True)
class ToolDescription:
    """A robot of the suite on a link of an arm: everything in its world is attached to the link.

    Attributes:
        robot: Its name, or its YAML file, relative to the file that names it.
        on: Name of the link.
        pose: Pose of the tool's world in the frame of the link (its scale is not used).
        without: Names of its bodies, joints, attachments, rigid bodies, collisions and sensors to leave out,
            such as the floor of its own scene.
    """

    robot: SceneName
    on: str
    pose: Placement = Placement()
    without: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmDescription:
    """A rigid robot in a file; its joints come first among the scene's, each exactly at its command.

    Attributes:
        urdf: The file: URDF, or xacro (`.xacro`), which is expanded.
        arguments: Values of a xacro file's arguments, by name.
        pose: Pose of its root link in the world (its scale is not used).
        start: Positions in [rad] or [m] at which the scene is built, by joint; others are at 0, or as near as
            their limits allow.
        touch: Whether the collision shapes of its links touch other bodies; they never touch each other.
        tools: The tools it carries.
    """

    urdf: Path
    arguments: dict[str, str] = field(default_factory=dict)
    pose: Placement = Placement()
    start: dict[str, float] = field(default_factory=dict)
    touch: bool = True
    tools: tuple[ToolDescription, ...] = ()

    def __post_init__(self) -> None:
        need_finite("arm", "start", tuple(self.start.values()))
