"""Messages about a scene: its structure, edits, and the proposal that they make; both sides are checked."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from softsim_core.base import Array, CommandError
from softsim_core.scene import RobotDescription
from softsim_core.scene.editing import Edit, Put, Remove
from softsim_core.scene.io import Item, Place, Steps, read_description

MOST_NAMES: Final = 5000
LONGEST_NAME: Final = 300


def require_list(value: Any) -> list[Any]:
    """Return a list of at most MOST_NAMES items; raise TypeError for anything else."""
    if not isinstance(value, list) or len(value) > MOST_NAMES:
        raise TypeError(f"a list of at most {MOST_NAMES}")
    return value


def text_of(value: Any) -> str:
    """Return a text; raise TypeError for anything else."""
    if not isinstance(value, str):
        raise TypeError("text")
    return value


def name_of(value: Any) -> str:
    """Return a name that viser also accepts for nodes and options."""
    found = text_of(value)
    if not 0 < len(found) <= LONGEST_NAME or not found.isprintable() or ".." in found:
        raise ValueError("name")
    return found


def whole(value: Any) -> int:
    """Return an integer >= 0."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < math.inf:
        raise TypeError("a whole number")
    return value


@contextmanager
def _refusing(what: str, text: str, longest: int, form: str) -> Iterator[None]:
    """Raise CommandError for a text that is too long, and for one that cannot be read inside the context."""
    if len(text) > longest:
        raise CommandError(f"{what} refused: longer than {longest} characters")
    try:
        yield
    except CommandError:
        raise
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, RecursionError) as error:
        raise CommandError(f"{what} refused: {form} ({type(error).__name__}: {error!s:.80})") from error


LONGEST_TEXT: Final = 8_000_000


@dataclass(frozen=True)
class SceneMessage:
    """Content of `scene/structure`, see `softsim_ros.nodes.simulator.scene_topics`.

    Attributes:
        generation: Number of the scene; it changes with another scene and when the same one is reloaded.
        robot: The scene; its `source` is the name of its file, which is not read here.
        overrides: YAML text of the values that override its file.
        frames: Names in the order of the topic `frames`.
        bodies: `name`, `points`, `triangles`, `nodes`, `colour` of each.
        regions: `name` and `nodes` of each rigid region.
        scenes: Names of the scenes that the simulator can load.
        places: File and line of the parts of the scene, see `places_of`.
        checksums: Checksums of the meshes of this scene, by topic, see `mesh_checksum`.
    """

    generation: int
    robot: RobotDescription
    overrides: str = ""
    frames: tuple[str, ...] = ()
    bodies: tuple[Mapping[str, Any], ...] = ()
    regions: tuple[Mapping[str, Any], ...] = ()
    scenes: tuple[str, ...] = ()
    places: Mapping[str, Place] = field(default_factory=dict)
    checksums: Mapping[str, int] = field(default_factory=dict)

    def owns(self, topic: str, checksum: int) -> bool:
        """Return whether a mesh on a topic belongs to this scene; True if there is no checksum for it."""
        return self.checksums.get(topic, checksum) == checksum


def read_scene_message(text: str) -> SceneMessage:
    """Return the scene in a message.

    Raises:
        CommandError: it is no message of a simulator.
        ConfigError: its description cannot be read.
    """
    with _refusing("scene", text, LONGEST_TEXT, "no message of this version's simulator"):
        try:
            data = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise CommandError(f"scene refused: no JSON ({type(error).__name__})") from error
        places = {text_of(key): _place(place) for key, place in dict(data["places"]).items()}
        source = Path(places[""][0]) if "" in places else None
        return SceneMessage(
            generation=whole(data["generation"]),
            robot=replace(read_description(text_of(data["description"])), source=source),
            overrides=text_of(data["overrides"]),
            frames=tuple(map(name_of, require_list(data["frames"]))),
            bodies=tuple(map(_body, require_list(data["bodies"]))),
            regions=tuple(map(_region, require_list(data["regions"]))),
            scenes=tuple(map(name_of, require_list(data["scenes"]))),
            places=places,
            checksums={
                text_of(key): whole(number) for key, number in dict(data.get("checksums", {})).items()
            },
        )


def _body(data: Any) -> dict[str, Any]:
    colour = [float(channel) for channel in data["colour"]]
    if len(colour) != 4 or not all(0.0 <= channel <= 1.0 for channel in colour):
        raise ValueError("colour")
    spans = {key: _span(data[key]) for key in ("points", "triangles", "nodes")}
    return {"name": name_of(data["name"]), "colour": tuple(colour), **spans}


def _region(data: Any) -> dict[str, Any]:
    return {"name": name_of(data["name"]), "nodes": [whole(node) for node in data["nodes"]]}


def _span(value: Any) -> tuple[int, int]:
    """Return first and end index."""
    begin, end = map(whole, value)
    if end < begin:
        raise ValueError("span")
    return begin, end


def _place(value: Any) -> Place:
    file, line = value
    return text_of(file), whole(line)


LONGEST_EDIT: Final = 100_000
MOST_EDITS: Final = 200
LONGEST_PROPOSAL: Final = 8_000_000
MOST_POINTS: Final = 2000
"""Largest number of points in a message for the nodes that a part selects."""


@dataclass(frozen=True)
class ChosenPoints:
    """Nodes that a part of the proposed scene selects.

    Attributes:
        part: Name of the part, such as "attachments/base".
        count: Number of selected nodes.
        points: Their rest positions in [m], shape (k, 3), k at most MOST_POINTS.
        problem: Why the scene cannot run so; "" if it can.
    """

    part: str
    count: int
    points: Array
    problem: str = ""


@dataclass(frozen=True)
class Proposal:
    """Content of `scene/proposal`.

    Attributes:
        revision: A number that grows with every message.
        robot: The scene as it is proposed; None: it cannot be edited; `message` has the reason.
        file: The file to which it would be saved.
        unsaved: Why it cannot be saved there; "": it can.
        undoable, redoable: How many changes can be undone and redone.
        is_changed: Whether it differs from the file.
        is_applied: Whether it is the running scene.
        message: Result of the last request.
        chosen: Nodes that its parts select.
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
    message: str = ""
    chosen: tuple[ChosenPoints, ...] = ()
    routes: Mapping[str, Array] = field(default_factory=dict)

    @property
    def problems(self) -> tuple[str, ...]:
        """Problems of its parts, each with the name of the part."""
        return tuple(f"{each.part}: {each.problem}" for each in self.chosen if each.problem)


# --- edits -----------------------------------------------------------------------------------------------


def write_edits(edits: Sequence[Edit], stroke: str = "") -> str:
    """Return edits that belong together as text for the topic `scene/edit`."""
    return json.dumps({"edits": [_plain(edit) for edit in edits], "stroke": stroke})


def read_edits(text: str) -> tuple[tuple[Edit, ...], str]:
    """Return the edits in a text of `write_edits`, and their stroke.

    Raises:
        CommandError: it contains no valid edits.
    """
    with _refusing("edit", text, LONGEST_EDIT, "not of the form in docs/edit.md"):
        data = json.loads(text)
        edits, stroke = data["edits"], data.get("stroke", "")
        if set(data) - {"edits", "stroke"} or not isinstance(edits, list) or len(edits) > MOST_EDITS:
            raise TypeError(f"`edits`, a list of at most {MOST_EDITS}, and `stroke`")
        return tuple(map(_edit, edits)), text_of(stroke)


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
        return Item(text_of(data["name"]))
    return text_of(data)


# --- the proposal ----------------------------------------------------------------------------------------


def write_proposal(proposal: Proposal, description: str) -> str:
    """Return a proposal as text for its topic; `description` is its scene as YAML text, "" without one."""
    return json.dumps(
        {
            "revision": proposal.revision,
            "description": description,
            "file": proposal.file,
            "unsaved": proposal.unsaved,
            "undoable": proposal.undoable,
            "redoable": proposal.redoable,
            "changed": proposal.is_changed,
            "applied": proposal.is_applied,
            "sentence": proposal.message,
            "chosen": [
                {
                    "part": each.part,
                    "count": each.count,
                    "points": _rows(each.points),
                    "problem": each.problem,
                }
                for each in proposal.chosen
            ],
            "routes": {name: _rows(points) for name, points in proposal.routes.items()},
        }
    )


def read_proposal(text: str) -> Proposal:
    """Return the proposal in a text of `write_proposal`; no file is accessed, no code runs.

    Raises:
        CommandError: it is no message of a simulator.
        ConfigError: its description cannot be read.
    """
    with _refusing("proposal", text, LONGEST_PROPOSAL, "not of this version's form"):
        data = json.loads(text)
        description = text_of(data["description"])
        return Proposal(
            revision=whole(data["revision"]),
            robot=read_description(description) if description else None,
            file=text_of(data["file"]),
            unsaved=text_of(data["unsaved"]),
            undoable=whole(data["undoable"]),
            redoable=whole(data["redoable"]),
            is_changed=data["changed"] is True,
            is_applied=data["applied"] is True,
            message=text_of(data["sentence"]),
            chosen=tuple(map(_parse_chosen_points, require_list(data["chosen"]))),
            routes={name_of(name): _points(rows) for name, rows in dict(data["routes"]).items()},
        )


def _parse_chosen_points(data: Any) -> ChosenPoints:
    points = _points(data["points"])
    return ChosenPoints(name_of(data["part"]), whole(data["count"]), points, text_of(data["problem"]))


def _rows(points: Array) -> list[list[float]]:
    """Return rows (k, 3) in [m], rounded to a micrometre."""
    rows: list[list[float]] = np.round(points, 6).tolist()
    return rows


def _points(rows: Any) -> Array:
    points = np.array(rows, dtype=float).reshape(-1, 3)
    if len(points) > MOST_POINTS or not np.isfinite(points).all():
        raise ValueError("points")
    return points
