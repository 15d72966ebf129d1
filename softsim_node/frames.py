"""Names of frames in headers and on /tf: those of REP 105, with a prefix for each robot."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

from softsim_core.base import CommandError, shorten


def prefix_of(namespace: str) -> str:
    """Return the prefix of a robot's frames: "left/" for the namespace /left, empty for the root."""
    name = namespace.strip("/")
    return f"{name}/" if name else ""


WORLD: Final = "world"
"""The only frame that all robots share."""

BASE_LINK: Final = "base_link"
EFFECTOR: Final = "effector"

_PREFIX: Final = re.compile(r"(?:[A-Za-z0-9_][A-Za-z0-9_/]*)?")


@dataclass(frozen=True, slots=True)
class RobotFrames:
    """Names of the frames of one robot.

    Attributes:
        prefix: Prefix of every name but `world`; letters, digits, underscores and slashes.

    Raises:
        CommandError: the prefix is not allowed.
    """

    prefix: str = ""

    def __post_init__(self) -> None:
        if not _PREFIX.fullmatch(self.prefix):
            raise CommandError(
                f"frame_prefix {shorten(self.prefix)!r} is refused; allowed are letters, digits, '_' and "
                "'/', not beginning with '/', such as left/"
            )

    def of(self, link: str) -> str:
        """Return the frame of a link of the robot's description."""
        return f"{self.prefix}{link}"

    @property
    def base(self) -> str:
        """Frame of the robot's base, at the origin of the world."""
        return self.of(BASE_LINK)

    @property
    def effector(self) -> str:
        """Frame of the end effector."""
        return self.of(EFFECTOR)
