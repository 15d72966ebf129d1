"""Edits of a scene, and the simulator's message about the scene that they propose, as texts; both checked."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from softsim_core.arrays import Array
from softsim_core.editing import Edit, Put, Remove
from softsim_core.errors import CommandError
from softsim_core.scene.overrides import Item, Steps
from softsim_core.scene.portable import read_description
from softsim_core.scene.robot import RobotDescription
from softsim_ros.messages import checks

LONGEST_EDIT: Final = 100_000
MOST_EDITS: Final = 200
LONGEST_PROPOSAL: Final = 8_000_000
MOST_POINTS: Final = 2000
"""So many of the nodes that a part chooses are told."""


@dataclass(frozen=True)
class ChosenPoints:
    """Nodes that a part of the proposed scene chooses.

    Attributes:
        part: Such as "attachments/base".
        count: How many.
        points: Where they are at rest in [m], shape (k, 3), k at most MOST_POINTS.
        problem: Why the scene cannot run so; "": nothing.
    """

    part: str
    count: int
    points: Array
    problem: str = ""


@dataclass(frozen=True)
class Proposal:
    """What `scene/proposal` tells.

    Attributes:
        revision: A number that grows with every message.
        robot: The scene as it is proposed; None: it cannot be edited, and `sentence` says why.
        file: The file that it would be saved to.
        unsaved: Why it cannot be saved there; "": it can.
        undoable, redoable: How many changes can be undone, and done again.
        is_changed: Whether it differs from the file.
        is_applied: Whether it is what runs.
        sentence: What came of the last request.
        chosen: What its parts choose.
        routes: Points of its cables in the world in [m], shapes (k, 3), by their joints.
    """

    revision: int
    robot: RobotDescription | None = None
    file: str = ""
    unsaved: str = ""
    undoable: int = 0
    redoable: int = 0
    is_changed: bool = False
    is_applied: bool = True
    sentence: str = ""
    chosen: tuple[ChosenPoints, ...] = ()
    routes: Mapping[str, Array] = field(default_factory=dict)

    @property
    def problems(self) -> tuple[str, ...]:
        """What is wrong with parts of it, each with the name of the part."""
        return tuple(f"{each.part}: {each.problem}" for each in self.chosen if each.problem)


# --- edits -----------------------------------------------------------------------------------------------


def write_edits(edits: Sequence[Edit], stroke: str = "") -> str:
    """Edits that belong together, as the topic `scene/edit` takes them."""
    return json.dumps({"edits": [_plain(edit) for edit in edits], "stroke": stroke})


def read_edits(text: str) -> tuple[tuple[Edit, ...], str]:
    """The edits of `write_edits`, and their stroke.

    Raises:
        CommandError: they are none.
    """
    if len(text) > LONGEST_EDIT:
        raise CommandError(f"edit refused: longer than {LONGEST_EDIT} characters")
    try:
        data = json.loads(text)
        edits, stroke = data["edits"], data.get("stroke", "")
        if set(data) - {"edits", "stroke"} or not isinstance(edits, list) or len(edits) > MOST_EDITS:
            raise TypeError(f"`edits`, a list of at most {MOST_EDITS}, and `stroke`")
        return tuple(map(_edit, edits)), checks.text(stroke)
    except (ValueError, RecursionError, KeyError, TypeError, AttributeError) as error:
        raise CommandError(
            f"edit refused: not of the form that docs/edit.md tells ({type(error).__name__}: {error!s:.80})"
        ) from error


def _plain(edit: Edit) -> dict[str, Any]:
    at = [{"name": step.name} if isinstance(step, Item) else step for step in edit.steps]
    return {"at": at, "put": edit.value} if isinstance(edit, Put) else {"at": at, "remove": True}


def _edit(data: Any) -> Edit:
    steps: Steps = tuple(_step(step) for step in data["at"])
    if set(data) == {"at", "put"}:
        return Put(steps, data["put"])
    if set(data) == {"at", "remove"} and data["remove"] is True:
        return Remove(steps)
    raise TypeError("`at`, and `put` or `remove`")


def _step(data: Any) -> str | Item:
    if isinstance(data, dict) and set(data) == {"name"}:
        return Item(checks.text(data["name"]))
    return checks.text(data)


# --- the proposal ----------------------------------------------------------------------------------------


def write_proposal(told: Proposal, description: str) -> str:
    """A proposal as the topic carries it; `description` is its scene as YAML text, "" without one."""
    return json.dumps(
        {
            "revision": told.revision,
            "description": description,
            "file": told.file,
            "unsaved": told.unsaved,
            "undoable": told.undoable,
            "redoable": told.redoable,
            "changed": told.is_changed,
            "applied": told.is_applied,
            "sentence": told.sentence,
            "chosen": [
                {
                    "part": each.part,
                    "count": each.count,
                    "points": _rows(each.points),
                    "problem": each.problem,
                }
                for each in told.chosen
            ],
            "routes": {name: _rows(points) for name, points in told.routes.items()},
        }
    )


def read_proposal(text: str) -> Proposal:
    """The proposal of `write_proposal`; no file is looked for, no code runs.

    Raises:
        CommandError: it is no message of a simulator.
        ConfigError: its description cannot be read.
    """
    if len(text) > LONGEST_PROPOSAL:
        raise CommandError(f"proposal refused: longer than {LONGEST_PROPOSAL} characters")
    try:
        data = json.loads(text)
        description = checks.text(data["description"])
        return Proposal(
            revision=checks.whole(data["revision"]),
            robot=read_description(description) if description else None,
            file=checks.text(data["file"]),
            unsaved=checks.text(data["unsaved"]),
            undoable=checks.whole(data["undoable"]),
            redoable=checks.whole(data["redoable"]),
            is_changed=data["changed"] is True,
            is_applied=data["applied"] is True,
            sentence=checks.text(data["sentence"]),
            chosen=tuple(map(_chosen, checks.listed(data["chosen"]))),
            routes={checks.name(name): _points(rows) for name, rows in dict(data["routes"]).items()},
        )
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, RecursionError) as error:
        if isinstance(error, CommandError):
            raise
        raise CommandError(
            f"proposal refused: not of this version's form ({type(error).__name__}: {error!s:.70})"
        ) from error


def _chosen(data: Any) -> ChosenPoints:
    points = _points(data["points"])
    return ChosenPoints(
        checks.name(data["part"]), checks.whole(data["count"]), points, checks.text(data["problem"])
    )


def _rows(points: Array) -> list[list[float]]:
    """Rows (k, 3) in [m], to a micrometre."""
    rows: list[list[float]] = np.round(points, 6).tolist()
    return rows


def _points(rows: Any) -> Array:
    points = np.array(rows, dtype=float).reshape(-1, 3)
    if len(points) > MOST_POINTS or not np.isfinite(points).all():
        raise ValueError("points")
    return points
