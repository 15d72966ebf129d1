"""The simulator's message about its scene, checked: all that the page knows of a scene comes from it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from softsim_core.errors import CommandError
from softsim_core.scene.location import Place
from softsim_core.scene.portable import read_description
from softsim_core.scene.robot import RobotDescription
from softsim_ros.messages import checks

LONGEST_TEXT: Final = 8_000_000


@dataclass(frozen=True)
class SceneMessage:
    """What `scene/structure` tells, see `softsim_ros.simulator.structure`.

    Attributes:
        generation: Number of the scene; another one is another scene, or the same one loaded anew.
        robot: The scene; its `source` is the name of its file, which is not read here.
        overrides: YAML text of what is laid over its file.
        frames: Names in the order of the topic `frames`.
        bodies: `name`, `points`, `triangles`, `nodes`, `colour` of each.
        regions: `name` and `nodes` of each rigid region.
        scenes: Names of the scenes that the simulator can load.
        places: Where the parts of the scene are written, see `places_of`.
        checksums: Of the meshes that belong to this scene, by their topics, see `mesh_checksum`.
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
        places = {checks.text(key): _place(place) for key, place in dict(data["places"]).items()}
        source = Path(places[""][0]) if "" in places else None
        return SceneMessage(
            generation=checks.whole(data["generation"]),
            robot=replace(read_description(checks.text(data["description"])), source=source),
            overrides=checks.text(data["overrides"]),
            frames=tuple(map(checks.name, checks.listed(data["frames"]))),
            bodies=tuple(map(_body, checks.listed(data["bodies"]))),
            regions=tuple(map(_region, checks.listed(data["regions"]))),
            scenes=tuple(map(checks.name, checks.listed(data["scenes"]))),
            places=places,
            checksums={
                checks.text(key): checks.whole(number)
                for key, number in dict(data.get("checksums", {})).items()
            },
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
    return {"name": checks.name(data["name"]), "colour": tuple(colour), **spans}


def _region(data: Any) -> dict[str, Any]:
    return {"name": checks.name(data["name"]), "nodes": [checks.whole(node) for node in data["nodes"]]}


def _span(value: Any) -> tuple[int, int]:
    """First and end index."""
    begin, end = map(checks.whole, value)
    if end < begin:
        raise ValueError("span")
    return begin, end


def _place(value: Any) -> Place:
    file, line = value
    return checks.text(file), checks.whole(line)
