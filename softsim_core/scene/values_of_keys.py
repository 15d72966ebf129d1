"""Single values of a scene's file: what a key may hold, and the sentence that refuses anything else."""

from __future__ import annotations

import math
import numbers
import typing
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from softsim_core.scene.yaml_source import KeyPath
from softsim_core.wrong_names import known_names, one_of

Hook = Callable[[Any, Any], Any]
"""What makes of plain data, and of the type that is wanted, a value."""


class RefusedValue(Exception):  # noqa: N818  # no user meets it: it becomes a ConfigError
    """A value that does not fit its key; `below` is the rest of the key path."""

    def __init__(self, problem: str, below: KeyPath = ()) -> None:
        self.problem, self.below = problem, below
        super().__init__(problem)


def shown(value: Any) -> str:
    """A value as a message shows it."""
    if value is None:
        return "empty"
    if isinstance(value, Mapping):
        return "a mapping"
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def as_number(value: Any, _: Any) -> float:
    """A number, and not NaN."""
    if isinstance(value, numbers.Real) and not isinstance(value, bool | np.bool_):
        try:
            number = float(value)
        except OverflowError:
            number = math.nan
        if not math.isnan(number):
            return number
    raise RefusedValue(f"must be a number, not {shown(value)}{_number_hint(value)}")


def _number_hint(value: Any) -> str:
    if not isinstance(value, str):
        return ""
    try:
        number = float(value)
    except ValueError:
        return ""
    mantissa, _, exponent = repr(number).partition("e")
    if exponent:  # YAML 1.1 wants a point and a signed exponent
        mantissa = mantissa if "." in mantissa else f"{mantissa}.0"
        exponent = f"e{exponent}" if exponent[0] in "+-" else f"e+{exponent}"
    return f", which YAML reads as text; write {mantissa}{exponent}"


def as_whole_number(value: Any, _: Any) -> int:
    """A whole number."""
    if isinstance(value, numbers.Integral) and not isinstance(value, bool | np.bool_):
        return int(value)
    raise RefusedValue(f"must be a whole number, not {shown(value)}")


def as_boolean(value: Any, _: Any) -> bool:
    """True or false."""
    if isinstance(value, bool):
        return value
    raise RefusedValue(f"must be true or false, not {shown(value)}")


def as_text(value: Any, _: Any) -> str:
    """A text."""
    if isinstance(value, str):
        return value
    raise RefusedValue(f"must be text, not {shown(value)}" + ("" if value is None else "; quote it"))


def as_path(value: Any, _: Any) -> Path:
    """A path, whether or not there is such a file."""
    if isinstance(value, str | Path) and str(value):
        return Path(value)
    raise RefusedValue(f"must be a file path, not {shown(value)}")


def as_instance(value: Any, cls: type) -> Any:
    """An object as it is, which no file can give."""
    if isinstance(value, cls):
        return value
    raise RefusedValue(f"comes from Python scenes only, not {shown(value)}")


def as_one_of(literal: Any) -> Hook:
    """One of the values of a Literal."""
    allowed = typing.get_args(literal)

    def structure(value: Any, _: Any) -> Any:
        for each in allowed:
            if type(value) is type(each) and value == each:
                return each
        raise RefusedValue(f"must be {one_of(value, allowed)}, not {shown(value)}")

    return structure


def as_threads(value: Any, _: Any) -> Any:
    """A number of threads, or auto."""
    if value != "auto" and (isinstance(value, bool) or not isinstance(value, int)):
        raise RefusedValue(f"must be auto or a whole number, not {value!r}")
    return value


def refuse_unknown(value: Mapping[Any, Any], known: list[str], read_before: Sequence[str] = ()) -> None:
    """Refuse a mapping with a key that is not known; the message lists those that were read before, too."""
    for key in value:
        if key not in known:
            allowed = known_names(key, [*known, *read_before], "known keys:", whole=True)
            raise RefusedValue(f"unknown key; {allowed}", (str(key),))
