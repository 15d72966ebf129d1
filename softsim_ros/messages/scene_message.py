"""The simulator's message about its scene, checked: all that the page knows of a scene comes from it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from softsim_core.errors import CommandError
from softsim_core.scene.location import Place
from softsim_core.scene.portable import read_description
from softsim_core.scene.robot import RobotDescription

LONGEST_TEXT: Final = 8_000_000
MOST_NAMES: Final = 5000
LONGEST_NAME: Final = 300


@dataclass(frozen=True)
class SceneMessage:
    """What `scene/structure` tells, see `softsim_ros.simulator.structure`.

    Attributes:
        generation: Number of the scene; another one is another scene, or the same one loaded anew.
        robot: The scene; its `source` is the name of its file, which is not read here.
        overrides: YAML text of what is laid over its file.
        frames: Names in the order of the topic `frames`.
        bodies: `name`, `points`, `triangles`, `nodes`, `colour` of each.
        zones: `name` and `nodes` of each rigid zone.
        scenes: Names of the scenes that the simulator can load.
        places: Where the parts of the scene are written, see `places_of`.
        checksums: Of the meshes that belong to this scene, by their topics, see `mesh_checksum`.
    """

    generation: int
    robot: RobotDescription
    overrides: str = ""
    frames: tuple[str, ...] = ()
    bodies: tuple[Mapping[str, Any], ...] = ()
    zones: tuple[Mapping[str, Any], ...] = ()
    scenes: tuple[str, ...] = ()
    places: Mapping[str, Place] = field(default_factory=dict)
    checksums: Mapping[str, int] = field(default_factory=dict)

    def owns(self, topic: str, checksum: int) -> bool:
        """Whether a mesh on a topic is this scene's; one of an older simulator, which tells none, may be."""
        return self.checksums.get(topic, checksum) == checksum


def read_scene_message(text: str) -> SceneMessage:
    """The scene that a message tells.

    Raises:
        CommandError: it is no message of a simulator.
        ConfigError: its description cannot be read.
    """
    if len(text) > LONGEST_TEXT:
        raise CommandError(f"scene refused: longer than {LONGEST_TEXT} characters")
    try:
        data = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise CommandError(f"scene refused: no JSON ({type(error).__name__})") from error
    try:
        places = {_text(key): _place(place) for key, place in dict(data["places"]).items()}
        source = Path(places[""][0]) if "" in places else None
        return SceneMessage(
            generation=_whole(data["generation"]),
            robot=replace(read_description(_text(data["description"])), source=source),
            overrides=_text(data["overrides"]),
            frames=tuple(map(_name, _list(data["frames"]))),
            bodies=tuple(map(_body, _list(data["bodies"]))),
            zones=tuple(map(_zone, _list(data["zones"]))),
            scenes=tuple(map(_name, _list(data["scenes"]))),
            places=places,
            checksums={_text(key): _whole(number) for key, number in dict(data.get("checksums", {})).items()},
        )
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        if isinstance(error, CommandError):
            raise
        raise CommandError(
            f"scene refused: no message of this version's simulator ({type(error).__name__}: {error!s:.80})"
        ) from error


def _body(data: Any) -> dict[str, Any]:
    colour = [float(channel) for channel in data["colour"]]
    if len(colour) != 4 or not all(0.0 <= channel <= 1.0 for channel in colour):
        raise ValueError("colour")
    spans = {key: _span(data[key]) for key in ("points", "triangles", "nodes")}
    return {"name": _name(data["name"]), "colour": tuple(colour), **spans}


def _zone(data: Any) -> dict[str, Any]:
    return {"name": _name(data["name"]), "nodes": [_whole(node) for node in data["nodes"]]}


def _span(value: Any) -> tuple[int, int]:
    """First and end index."""
    begin, end = map(_whole, value)
    if end < begin:
        raise ValueError("span")
    return begin, end


def _place(value: Any) -> Place:
    file, line = value
    return _text(file), _whole(line)


def _list(value: Any) -> list[Any]:
    if not isinstance(value, list) or len(value) > MOST_NAMES:
        raise TypeError(f"a list of at most {MOST_NAMES}")
    return value


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError("text")
    return value


def _name(value: Any) -> str:
    """A name that can be one of viser's nodes and options, too."""
    text = _text(value)
    if not 0 < len(text) <= LONGEST_NAME or not text.isprintable() or ".." in text:
        raise ValueError("name")
    return text


def _whole(value: Any) -> int:
    """A whole number >= 0."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < math.inf:
        raise TypeError("a whole number")
    return value
