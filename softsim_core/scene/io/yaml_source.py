"""Safe YAML parser: duplicate keys are errors, and mappings record which file wrote each key."""

from __future__ import annotations

import importlib
import pickle
from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, TypeAlias

from softsim_core.base import ConfigError, listing

MOST_CHARACTERS: Final = 4_000_000
"""A longer text is rejected before it is parsed."""

MOST_VALUES: Final = 200_000
"""Largest number of values in a text; each alias counts as the values that it stands for."""

MOST_EXTENDED: Final = 32
"""Largest depth of files that extend each other."""

KeyPath: TypeAlias = tuple[str | int, ...]
"""Steps from the top of a file to a value: ("bodies", 0, "material")."""

Place: TypeAlias = tuple[int, int]
"""Line and column in a file, counted from 1."""


class SourcedMapping(dict[str, Any]):
    """A mapping read from a file; `file_of(key)` names the file, None for values that come from no file.

    Attributes:
        file: The file from which most of it comes.
        places: Locations of its keys, as far as they are known.
    """

    def __init__(
        self, items: Mapping[str, Any], file: Path | None, places: Mapping[str, Place] | None = None
    ) -> None:
        super().__init__(items)
        self.file = file
        self.places = dict(places or {})
        self._files: dict[str, Path | None] = {}

    def file_of(self, key: str) -> Path | None:
        """Return the file that wrote this key."""
        return self._files.get(key, self.file)

    def put(self, key: str, value: Any, file: Path | None, place: Place | None = None) -> None:
        """Set a value that another file wrote, with its location."""
        self[key] = value
        self._files[key] = file
        self.places.pop(key, None)
        if place is not None:
            self.places[key] = place


def plain_copy(value: Any) -> Any:
    """Return data of files as plain mappings and lists, in which nothing is shared."""
    if isinstance(value, Mapping):
        return {key: plain_copy(each) for key, each in value.items()}
    return [plain_copy(each) for each in value] if isinstance(value, list | tuple) else value


def key_path(path: Iterable[str | int]) -> str:
    """Format a key path: ("bodies", 0, "name") is bodies[0].name."""
    text = ""
    for step in path:
        text += f"[{step}]" if isinstance(step, int) else f".{step}" if text else step
    return text


def read_yaml(file: Path) -> SourcedMapping:
    """Read the mapping of a YAML file; anchors, aliases and merge keys (<<) are resolved.

    The result of a recently parsed text is reused, because parsing takes longer than everything else in
    loading a scene.

    Raises:
        ConfigError: unreadable file, YAML syntax, a key given twice or not text, no mapping at the top.
    """
    try:
        with file.open(encoding="utf-8") as stream:
            text = stream.read(MOST_CHARACTERS + 1)
    except OSError as error:
        raise ConfigError(file, "", f"cannot be read ({error.strerror or error})") from error
    except UnicodeDecodeError as error:
        raise ConfigError(file, "", f"is not UTF-8 text (byte {error.start})") from error
    data: SourcedMapping = pickle.loads(_parse_pickled(text, file))  # an own copy, which may be changed
    return data


@lru_cache(maxsize=16)
def _parse_pickled(text: str, file: Path) -> bytes:
    return pickle.dumps(parse_yaml(text, file))


def parse_yaml(text: str, file: Path) -> SourcedMapping:
    """Parse YAML text to a mapping, as `read_yaml`; `file` is recorded as the origin of its keys.

    Raises:
        ConfigError: YAML syntax, a key given twice or not text, no mapping at the top, or more than
            MOST_CHARACTERS or MOST_VALUES.
    """
    if len(text) > MOST_CHARACTERS:
        raise ConfigError(file, "", f"is longer than {MOST_CHARACTERS} characters; make it shorter")
    try:
        yaml: Any = importlib.import_module("yaml")
    except ImportError as error:
        problem = "reading YAML needs PyYAML: pip install pyyaml (or apt install python3-yaml)"
        raise ConfigError(file, "", problem) from error
    try:
        loader = yaml.SafeLoader(text)
        node = loader.get_single_node()
        if node is None or not isinstance(node, yaml.MappingNode):
            raise ConfigError(file, "", "must hold `key: value` lines at the top level")
        if _values_in(node, {}) > MOST_VALUES:
            problem = f"holds more than {MOST_VALUES} values, aliases counted as all they hold"
            raise ConfigError(file, "", problem)
        data = _Reader(yaml, loader, file).value(node, ())
    except RecursionError:
        raise ConfigError(file, "", "is nested too deeply; write it flatter") from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
        where = f"line {mark.line + 1}, column {mark.column + 1}" if mark is not None else ""
        problem = getattr(error, "problem", None) or getattr(error, "reason", None) or "is not valid YAML"
        raise ConfigError(file, where, f"YAML syntax: {problem}") from error
    assert isinstance(data, SourcedMapping)
    return data


def _values_in(node: Any, counted: dict[int, int]) -> int:
    """Return the number of values of a YAML node; one that contains itself is counted once."""
    if id(node) not in counted:
        counted[id(node)] = 1
        parts = node.value if isinstance(node.value, list) else []
        below = [each for part in parts for each in (part if isinstance(part, tuple) else (part,))]
        counted[id(node)] = min(1 + sum(_values_in(each, counted) for each in below), MOST_VALUES + 1)
    return counted[id(node)]


class _Reader:
    """Converter of PyYAML's node graph to data; shared nodes (aliases) stay shared."""

    def __init__(self, yaml: Any, loader: Any, file: Path) -> None:
        self._yaml, self._loader, self._file = yaml, loader, file
        self._done: dict[int, Any] = {}
        self._open: set[int] = set()

    def value(self, node: Any, path: KeyPath) -> Any:
        if id(node) in self._done:
            return self._done[id(node)]
        if id(node) in self._open:
            raise ConfigError(self._file, key_path(path), "an alias points to something that contains it")
        self._open.add(id(node))
        if not isinstance(node, self._yaml.ScalarNode) and not node.tag.endswith((":map", ":seq")):
            problem = f"the YAML tag {node.tag} is not allowed; remove it"
            raise ConfigError(self._file, key_path(path), problem)
        if isinstance(node, self._yaml.MappingNode):
            data: Any = self._mapping(node, path)
        elif isinstance(node, self._yaml.SequenceNode):
            data = [self.value(item, (*path, index)) for index, item in enumerate(node.value)]
        else:
            try:
                data = self._loader.construct_object(node)
            except ValueError as error:  # YAML takes 2026-13-45 for a date
                problem = f"{node.value!r} cannot be read ({error}); quote text"
                raise ConfigError(self._file, key_path(path), problem) from error
        self._open.discard(id(node))
        self._done[id(node)] = data
        return data

    def _mapping(self, node: Any, path: KeyPath) -> SourcedMapping:
        merged, own = SourcedMapping({}, self._file), SourcedMapping({}, self._file)
        for key_node, value_node in node.value:
            if key_node.tag == "tag:yaml.org,2002:merge":
                below = (*path, "<<")
                sources = self.value(value_node, below)
                for source in sources if isinstance(sources, list) else [sources]:
                    if not isinstance(source, SourcedMapping):
                        problem = "must be a mapping or a list of mappings"
                        raise ConfigError(self._file, key_path(below), problem)
                    places = {**source.places, **merged.places}
                    merged = SourcedMapping({**source, **merged}, self._file, places)  # the first wins
                continue
            key = self.value(key_node, path) if isinstance(key_node, self._yaml.ScalarNode) else None
            if isinstance(key, bool):  # YAML 1.1: bare on, off, yes, no are truth values
                key = key_node.value
            line, column = key_node.start_mark.line + 1, key_node.start_mark.column + 1
            if not isinstance(key, str):
                text = getattr(key_node, "value", "it")
                problem = f"line {line}: the key {text!r} is read as {key!r}, not as text; quote it"
                raise ConfigError(self._file, key_path(path), problem)
            if key in own:
                problem = f"given twice (again in line {line}); keep one"
                raise ConfigError(self._file, key_path((*path, key)), problem)
            own[key] = self.value(value_node, (*path, key))
            own.places[key] = line, column
        return SourcedMapping({**merged, **own}, self._file, {**merged.places, **own.places})


def merge(base: SourcedMapping, over: SourcedMapping, path: KeyPath = ()) -> SourcedMapping:
    """Merge `over` over `base`: mappings merge, lists of named items merge by name, others are replaced.

    A material that names a preset replaces the one below it; other keys change that preset, if it is one.

    Raises:
        ConfigError: a list that is merged by name names an item twice.
    """
    result = SourcedMapping({}, base.file)
    for key in dict.fromkeys((*base, *over)):
        if key not in over:
            result.put(key, base[key], base.file_of(key), base.places.get(key))
        elif key not in base:
            result.put(key, over[key], over.file_of(key), over.places.get(key))
        else:
            merged = _merge_values(base[key], over[key], (*path, key))
            result.put(key, merged, over.file_of(key), over.places.get(key))
    return result


def _merge_values(base: Any, over: Any, path: KeyPath) -> Any:
    if path[-1] == "material" and isinstance(over, SourcedMapping):
        if "preset" in over:
            return over
        if isinstance(base, str):
            base = SourcedMapping({"preset": base}, over.file)
    if isinstance(base, SourcedMapping) and isinstance(over, SourcedMapping):
        return merge(base, over, path)
    if _is_named_list(base) and isinstance(over, list):
        for index, item in enumerate(over):
            if isinstance(item, SourcedMapping) and "name" not in item:
                first = next(iter(item), "")
                problem = (
                    f"item {index} has no `name`; items are laid over those of the file below by their names"
                )
                where = item.file_of(first) or "scene"
                raise ConfigError(where, key_path((*path, index)), problem, item.places.get(first))
    if _is_named_list(base) and _is_named_list(over):
        items = _by_name(base, path)
        for name, item in _by_name(over, path).items():
            items[name] = merge(items[name], item, (*path, name)) if name in items else item
        return list(items.values())
    return over


def _by_name(items: list[SourcedMapping], path: KeyPath) -> dict[str, SourcedMapping]:
    names: dict[str, SourcedMapping] = {}
    for index, item in enumerate(items):
        if item["name"] in names:
            where = item.file_of("name") or "scene"
            problem = f"a second item is named {item['name']}"
            raise ConfigError(where, key_path((*path, index)), problem, item.places.get("name"))
        names[item["name"]] = item
    return names


def _is_named_list(value: Any) -> bool:
    return (
        isinstance(value, list)
        and bool(value)
        and all(isinstance(item, SourcedMapping) and isinstance(item.get("name"), str) for item in value)
    )


def read_extended(file: Path, below: tuple[Path, ...] = ()) -> SourcedMapping:
    """Read a YAML file merged over the file that its key `extends` names (relative to it), recursively.

    Raises:
        ConfigError: as `read_yaml`; a missing base file; files that extend each other in a circle.
    """
    return resolve_extends(read_yaml(file), file, below)


def resolve_extends(data: SourcedMapping, file: Path, below: tuple[Path, ...] = ()) -> SourcedMapping:
    """Return the content of a YAML file merged over the file that its key `extends` names."""
    if "extends" not in data:
        return data
    target, place = data.pop("extends"), data.places.get("extends")
    if not isinstance(target, str):
        raise ConfigError(file, "extends", f"must name a YAML file, not {target!r}", place)
    base = relative_to_file(target, file)
    chain = (*below, file)
    if len(chain) > MOST_EXTENDED:
        problem = f"more than {MOST_EXTENDED} files extend each other; write them as fewer"
        raise ConfigError(file, "extends", problem, place)
    if base.resolve() in {each.resolve() for each in chain}:
        circle = f"files extend each other in a circle: {listing([*chain, base])}"
        raise ConfigError(file, "extends", circle, place)
    if not base.is_file():
        problem = f"no such file {base}; a relative path is relative to the file that names it"
        raise ConfigError(file, "extends", problem, place)
    return merge(read_extended(base, chain), data)


def relative_to_file(path: str | Path, file: Path | None) -> Path:
    """Return the absolute path of a file named relative to `file` (None: to the working directory).

    Raises:
        ConfigError: it cannot be a path: an unknown user's, too long, or with a null byte in it.
    """
    try:
        path = Path(path).expanduser()
        if path.is_absolute():
            return path
        if file is None:
            return path.absolute()
        direct = file.parent / path
        through_links = file.resolve().parent / path
        return (through_links if through_links.exists() and not direct.exists() else direct).resolve()
    except (OSError, RuntimeError, ValueError) as error:
        problem = f"{str(path)[:60]!r} is no path of a file ({error!s:.60})"
        raise ConfigError(file or "", "", problem) from error
