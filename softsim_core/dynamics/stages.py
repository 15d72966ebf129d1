"""The stages of a step as a tree: which is part of which, and what each takes itself."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

PART_OF: Final = {
    "controllers": "step",
    "assemble": "step",
    "factor": "step",
    "iterate": "step",
    "solve": "step",
    "update": "step",
    "sensors": "step",
    "detect": "step",
    "contact": "step",
    "compliance": "contact",
    "forces": "contact",
    "correct": "contact",
}
"""The stage that each is a part of; any other stands on its own."""


@dataclass(frozen=True, slots=True)
class StageShare:
    """A stage in the tree.

    Attributes:
        name: Name of the stage.
        level: How many stages it is inside.
        total: Its time, in the unit it was given in.
        own: Its time without that of its parts, >= 0.
    """

    name: str
    level: int
    total: float
    own: float


def stage_tree(times: Mapping[str, float]) -> list[StageShare]:
    """Stages in the order of a tree: each before its parts, parts and wholes in the order given.

    Args:
        times: Time of each stage by its name, all in one unit; a part whose whole is missing is one itself.
    """
    return [share for name in times if PART_OF.get(name) not in times for share in _branch(name, 0, times)]


def _branch(name: str, level: int, times: Mapping[str, float]) -> Iterator[StageShare]:
    parts = [part for part in times if PART_OF.get(part) == name]
    yield StageShare(name, level, times[name], max(0.0, times[name] - sum(times[part] for part in parts)))
    for part in parts:
        yield from _branch(part, level + 1, times)
