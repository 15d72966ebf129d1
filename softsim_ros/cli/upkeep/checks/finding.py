"""What a check says."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Level(Enum):
    """How bad it is: fine, worth knowing, or broken."""

    OK = "ok"
    WARNING = "warning"
    PROBLEM = "problem"


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the doctor.

    Attributes:
        level: How bad it is.
        subject: What was looked at.
        text: What was found.
        advice: What to do, where there is something to do.
    """

    level: Level
    subject: str
    text: str
    advice: str = ""
