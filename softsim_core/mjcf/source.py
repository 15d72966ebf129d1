"""The text of a MuJoCo model (MJCF), checked before MuJoCo's own library may read it.

A model can include other files, name meshes anywhere on the disk and request more memory than available.
Files outside its folder and sizes beyond the limits are rejected here.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

from softsim_core.base import MjcfError

MOST_BYTES: Final = 32_000_000
"""Size limit of the model's text, including all files that it includes."""
MOST_FILES: Final = 100
MOST_MESH_BYTES: Final = 200_000_000
"""Size limit of the meshes and pictures that it names, all together."""
MOST_VERTICES: Final = 50_000
"""Largest number of vertices of its flexes, all together."""

_DIRECTORIES = ("meshdir", "texturedir", "assetdir")
_WORDS = ("name", "class", "childclass", "model", "file", "prefix", "text", "data")
_FILES = ("file", "fileright", "fileup", "fileleft", "filedown", "filefront", "fileback", "vertex_file")


@dataclass(frozen=True, slots=True)
class Source:
    """The elements of a model: its file, and its root element before those of the included files."""

    file: Path
    roots: tuple[ElementTree.Element, ...]

    def elements(self) -> Iterator[tuple[ElementTree.Element, tuple[str, ...]]]:
        """Yield every element with the tags above it, in the order of the files."""
        for root in self.roots:
            waiting: list[tuple[ElementTree.Element, tuple[str, ...]]] = [(root, ())]
            while waiting:
                element, above = waiting.pop()
                yield element, above
                inner = (*above, element.tag)
                waiting += [(child, inner) for child in reversed(list(element)) if isinstance(child.tag, str)]


def read_source(path: str | Path) -> Source:
    """Read the elements of an MJCF file and of the files that it includes.

    Everything that it names must lie in its folder, or below.

    Raises:
        MjcfError: it is no MuJoCo model, cannot be read, is too long, or names files outside its folder.
    """
    file = Path(path).expanduser().absolute()
    roots: list[ElementTree.Element] = []
    files: set[Path] = set()
    waiting, length = [file], 0
    while waiting:
        one = waiting.pop(0)
        if one.resolve() in files:
            raise MjcfError(file, f"includes {one.name} twice or in a circle, which MuJoCo does not allow")
        files.add(one.resolve())
        if len(files) > MOST_FILES:
            raise MjcfError(file, f"includes more than {MOST_FILES} files; join them")
        if not one.is_file():
            what = "does not exist" if one == file else f"includes {one}, which does not exist"
            raise MjcfError(file, f"{what}; check the path")
        try:
            if one.stat().st_size > MOST_BYTES:
                raise MjcfError(one, f"is longer than {MOST_BYTES} bytes; make it shorter")
            text = one.read_bytes()
        except OSError as error:
            raise MjcfError(one, f"cannot be read: {error.strerror or error}") from error
        length += len(text)
        if length > MOST_BYTES:
            raise MjcfError(file, f"is longer than {MOST_BYTES} bytes with what it includes; make it shorter")
        root = _parse_xml(text, one)
        if one == file and root.tag != "mujoco":
            hint = "URDF; convert it with MuJoCo first" if root.tag == "robot" else "some other XML"
            raise MjcfError(file, f"is no MuJoCo model: its root is <{root.tag}>, not <mujoco> ({hint})")
        roots.append(root)
        for element in root.iter("include"):
            waiting.append(_inside(element.get("file", ""), file.parent, file, "include"))
        for element in root.iter("model"):  # an attached model, possibly several times
            attached = _inside(element.get("file", ""), file.parent, file, "model")
            if attached.resolve() not in (*files, *(each.resolve() for each in waiting)):
                waiting.append(attached)
    source = Source(file, tuple(roots))
    _check(source, {each.parent for each in files})
    return source


def _parse_xml(text: bytes, one: Path) -> ElementTree.Element:
    if re.search(rb"<!(DOCTYPE|ENTITY)", text):
        raise MjcfError(one, "declares a document type or entities, which MJCF has no use for; remove them")
    try:
        return ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, RecursionError, LookupError) as error:
        raise MjcfError(one, f"is no well-formed XML ({error}); look at that line") from error


def _check(source: Source, folders: set[Path]) -> None:
    """Raise an error for invalid numbers, files outside the folder, and too large files and grids.

    `folders` are those of the model's files, from which it may name others.
    """
    folder = source.file.parent
    directories = [folder, *sorted(folders - {folder.resolve()})]
    for element, _ in source.elements():
        if element.tag == "compiler":
            directories += [
                _inside(element.get(name, ""), folder, source.file, name)
                for name in _DIRECTORIES
                if element.get(name)
            ]
    size = vertices = 0
    for element, _ in source.elements():
        called = f"{element.tag} {element.get('name')}" if element.get("name") else element.tag
        for name, text in element.attrib.items():
            if name not in _WORDS and re.search(r"(?i)(^|[\s+-])(nan|inf|infinity)($|\s)", text):
                problem = f"{called}: {name} is {text[:40]!r}, which is no finite number"
                raise MjcfError(source.file, problem)
            if name in _FILES and text and element.tag != "include":
                # MuJoCo's search order is not known here: the file must lie inside for each directory. One
                # that is not found has no size; MuJoCo reports it.
                found = [_inside(text, each, source.file, f"{called}: {name}") for each in directories]
                size += max((each.stat().st_size for each in found if each.is_file()), default=0)
        if element.tag in ("flexcomp", "composite"):
            with suppress(ValueError, OverflowError):  # MuJoCo's own reader reports the problem
                vertices += math.prod(max(1, int(float(word))) for word in element.get("count", "1").split())
    if size > MOST_MESH_BYTES:
        problem = f"names meshes and pictures of {size} bytes, more than {MOST_MESH_BYTES}; simplify"
        raise MjcfError(source.file, problem)
    if vertices > MOST_VERTICES:
        problem = f"asks for {vertices} vertices, more than {MOST_VERTICES}; make its grids coarser"
        raise MjcfError(source.file, problem)


def _inside(text: str, directory: Path, file: Path, what: str) -> Path:
    """Return a path that a model names, which must lie in the folder of the model or below it."""
    if ":" in text or "\0" in text:
        raise MjcfError(file, f"{what} names {text[:80]!r}, which is no path of a file")
    found = directory / text
    if not found.resolve().is_relative_to(file.parent.resolve()):
        problem = "which lies outside the model's folder; put it beside the model"
        raise MjcfError(file, f"{what} names {text[:80]!r}, {problem}")
    return found
