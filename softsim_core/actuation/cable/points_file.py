"""Files that list the points of a cable: JSON or YAML, a list of [x, y, z]."""

from __future__ import annotations

import importlib
import json
import math
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from softsim_core.arrays import Array
from softsim_core.errors import ConfigError


def read_cable_points(file: str | PathLike[str]) -> Array:
    """Points of a cable in file units, from the pulled end to the anchored one, shape (k, 3).

    Args:
        file: JSON (.json) or YAML (.yaml, .yml): a list of lists of three numbers.

    Raises:
        ConfigError: the file is missing or damaged, or an entry is no point; names it.
    """
    path = Path(file)
    data = _read(path)
    if not isinstance(data, list) or not data:
        raise ConfigError(path, "", f"must be a list of points [x, y, z], not {_shown(data)}")
    for index, point in enumerate(data):
        if not isinstance(point, list) or len(point) != 3 or not all(map(_is_number, point)):
            raise ConfigError(path, f"[{index}]", f"must be a list of 3 finite numbers, not {_shown(point)}")
        if index and point == data[index - 1]:
            raise ConfigError(path, f"[{index}]", "lies where the point before it lies; remove one of them")
    return np.array(data, dtype=float)


def _read(path: Path) -> Any:
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(path, "", f"cannot be read ({error.strerror or error})") from error
    except UnicodeDecodeError as error:
        raise ConfigError(path, "", f"is not UTF-8 text (byte {error.start})") from error
    if path.suffix.lower() == ".json":
        try:
            return json.loads(text)
        except ValueError as error:
            raise ConfigError(path, "", f"is not JSON: {error}") from error
    if path.suffix.lower() not in (".yaml", ".yml"):
        raise ConfigError(path, "", "a file of cable points ends in .json, .yaml or .yml")
    yaml = importlib.import_module("yaml")
    try:
        return yaml.safe_load(text)
    except yaml.YAMLError as error:
        problem = getattr(error, "problem", None) or "is not valid YAML"
        raise ConfigError(path, "", f"YAML syntax: {problem}") from error


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _shown(value: Any) -> str:
    text = "empty" if value is None else json.dumps(value, default=str)
    return text if len(text) <= 60 else text[:57] + "..."
