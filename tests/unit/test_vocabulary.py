"""Names of the product use the words of docs/developers/vocabulary.md, not those that it retired."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from faces import REPOSITORY
from source_trees import tree_of

PACKAGES = ("softsim_core", "softsim_node", "softsim_ros", "servo_bridge", "benchmarks")
"""Packages whose names are checked."""

RETIRED = (
    "told", "tell", "tells", "telling", "sentence", "sentences", "held", "kept", "wish", "wishes",
    "wished", "obey", "obeys", "obeyed", "deed", "deeds", "belief", "beliefs", "believe", "believes",
    "judge", "judges", "judged", "room", "rooms", "aside", "heard", "hear", "hears", "seen", "spoken",
    "sensed", "led", "course", "courses", "door", "doors", "house", "houses", "wanted", "tried",
)  # fmt: skip
"""Words that no name contains."""

RETIRED_NOUNS = ("known", "given", "keep", "keeps")
"""Words that are no name alone; a name may contain them beside a noun or as a verb: `known_names`."""

RESULT = "attribute of a released result, which programs read"
FORMER = "former name of a released attribute, which warns"
OWN_ACTUATOR = "attribute that actuators of users set: the number of internal states"
HELD_OUT = "term of the field: rows that are held out of a fit; key of the data set's file"

ALLOWED = {
    "softsim_core.base.errors.given": "argument of ArrayError, which programs may create",
    "softsim_core.control.inverse.controller.sentence": FORMER,
    "softsim_core.control.observer.settings.sentence": FORMER,
    "softsim_core.lab.identification.description.held_out_share": HELD_OUT,
    "softsim_core.lab.identification.league.held_out": HELD_OUT,
    "softsim_core.lab.identification.session.held_out": HELD_OUT,
    "softsim_core.lab.identification.session.judged": FORMER,
    "softsim_core.lab.identification.validation.given": "keyword argument of validate_session",
    "softsim_core.lab.identification.validation.held_out": HELD_OUT,
    "softsim_core.lab.identification.validation.judged": FORMER,
    "softsim_core.lab.identification.validation.known": FORMER,
    "softsim_core.lab.learning.episodes._wanted": "key of a saved state",
    "softsim_core.lab.meshing.meshing.known": FORMER,
    "softsim_core.lab.meshing.meshing.told": FORMER,
    "softsim_core.lab.meshing.part.told": FORMER,
    "softsim_core.lab.meshing.repair.told": FORMER,
    "softsim_core.lab.study.cluster.told": "keyword argument of Where, a callback of the caller",
    "softsim_core.mjcf.exporting.told": FORMER,
    "softsim_core.mjcf.importing.told": FORMER,
    "softsim_core.physics.actuation.actuators.keeps": OWN_ACTUATOR,
    "softsim_core.physics.actuation.chamber.chamber.keeps": OWN_ACTUATOR,
    "softsim_ros.cli.measurements.validate_report.held_out": HELD_OUT,
    "softsim_ros.client.joints.obey": FORMER,
    "softsim_ros.client.services.sentence": FORMER,
    "softsim_ros.client.state.heard_goal": RESULT,
    "softsim_ros.excitation.measure.HELD_OUT": HELD_OUT,
}
"""Names with a retired word that stay, with their module, and why."""


def words_of(name: str) -> list[str]:
    """Split a name in snake case or camel case into lower-case words."""
    return [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+", name)]


def is_retired(name: str) -> bool:
    """Return whether a name contains a retired word."""
    words = words_of(name)
    return any(word in RETIRED for word in words) or (len(words) == 1 and words[0] in RETIRED_NOUNS)


def defined_names(tree: ast.AST) -> Iterator[tuple[str, int]]:
    """Yield each name that a module defines, with its line: of functions, classes, variables."""
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.ClassDef():
                yield node.name, node.lineno
            case ast.arg():
                yield node.arg, node.lineno
            case ast.Name(ctx=ast.Store()):
                yield node.id, node.lineno
            case ast.Attribute(ctx=ast.Store()):
                yield node.attr, node.lineno
            case ast.alias(asname=str(name)) | ast.ExceptHandler(name=str(name)):
                yield name, node.lineno
            case ast.MatchAs(name=str(name)) | ast.MatchStar(name=str(name)):
                yield name, node.lineno


def module_of(file: Path) -> str:
    """Return the dotted name of a module."""
    return ".".join(file.relative_to(REPOSITORY).with_suffix("").parts).removesuffix(".__init__")


def retired_names() -> dict[str, str]:
    """Return where each name with a retired word is defined first, by module and name."""
    found: dict[str, str] = {}
    for file in (file for package in PACKAGES for file in sorted((REPOSITORY / package).rglob("*.py"))):
        for name, line in defined_names(tree_of(file)):
            if is_retired(name):
                found.setdefault(
                    f"{module_of(file)}.{name}", f"{file.relative_to(REPOSITORY)}:{line}: {name}"
                )
    return found


def test_names_contain_no_retired_words() -> None:
    refused = [where for name, where in retired_names().items() if name not in ALLOWED]
    assert refused == [], "see docs/developers/vocabulary.md"


def test_every_allowed_name_exists() -> None:
    assert ALLOWED.keys() - retired_names().keys() == set()


@pytest.mark.parametrize(
    ("code", "names"),
    [
        ("def tell(sentence): pass", ["tell", "sentence"]),
        ("class KeyDeed: pass", ["KeyDeed"]),
        ("self.last_heard = room = 1", ["last_heard", "room"]),
        ("known = known_names()", ["known"]),
        ("for seen, _ in pairs: pass", ["seen"]),
        ("import course_of as course", ["course"]),
        ("def known_names(threshold, keep_going, roomy): unseen_rows = threshold.told", []),
    ],
)
def test_retired_words_are_found_in_names(code: str, names: list[str]) -> None:
    assert sorted(name for name, _ in defined_names(ast.parse(code)) if is_retired(name)) == sorted(names)
