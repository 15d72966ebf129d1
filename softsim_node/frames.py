"""Names of frames in headers and on /tf: those of REP 105, with a prefix for each robot."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

from softsim_core.base.errors import CommandError
from softsim_core.scene.io.catalog import shortened


def prefix_of(namespace: str) -> str:
    """The prefix of a robot's frames: its namespace and a slash, such as "left/"; empty for the root."""
    name = namespace.strip("/")
    return f"{name}/" if name else ""


WORLD: Final = "world"
"""The one frame that all robots share."""

BASE_LINK: Final = "base_link"
EFFECTOR: Final = "effector"

_PREFIX: Final = re.compile(r"(?:[A-Za-z0-9_][A-Za-z0-9_/]*)?")


@dataclass(frozen=True, slots=True)
class RobotFrames:
    """The frames of one robot.

    Attributes:
        prefix: Stands before every name but `world`; letters, digits, underscores and slashes.

    Raises:
        CommandError: the prefix is not allowed.
    """

    prefix: str = ""

    def __post_init__(self) -> None:
        if not _PREFIX.fullmatch(self.prefix):
            raise CommandError(
                f"frame_prefix {shortened(self.prefix)!r} is refused; allowed are letters, digits, '_' and "
                "'/', not beginning with '/', such as left/"
            )

    def of(self, link: str) -> str:
        """The frame of a link of the robot's description."""
        return f"{self.prefix}{link}"

    @property
    def base(self) -> str:
        """The robot's base, which stands in the world's origin."""
        return self.of(BASE_LINK)

    @property
    def effector(self) -> str:
        """The end effector."""
        return self.of(EFFECTOR)
