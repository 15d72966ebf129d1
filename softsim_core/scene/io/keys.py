"""Conversion of values in scene files: single values and materials."""

from __future__ import annotations

import math
import numbers
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from softsim_core.base import FieldError, SceneError, known_names, listing, one_of
from softsim_core.physics.fem.materials import DEFAULT_FIT, elastomer, material, material_names
from softsim_core.scene import DEFAULT_LAW, MaterialDescription, law_parameters
from softsim_core.scene.io.yaml_source import KeyPath

KIND = "kind"
"""Key of the kind of a sensor."""


class RefusedValue(Exception):  # noqa: N818  # no user meets it: it becomes a ConfigError
    """A value does not fit its key; `below` is the rest of the key path."""

    def __init__(self, problem: str, below: KeyPath = ()) -> None:
        self.problem, self.below = problem, below
        super().__init__(problem)


def format_value(value: Any) -> str:
    """Format a value for a message."""
    if value is None:
        return "empty"
    if isinstance(value, Mapping):
        return "a mapping"
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def as_number(value: Any, *below: str | int) -> float:
    """Convert to a number that is not NaN; `below` are the steps to it, for a refusal."""
    if isinstance(value, numbers.Real) and not isinstance(value, bool | np.bool_):
        try:
            number = float(value)
        except OverflowError:
            number = math.nan
        if not math.isnan(number):
            return number
    raise RefusedValue(f"must be a number, not {format_value(value)}{_number_hint(value)}", below)


def _number_hint(value: Any) -> str:
    if not isinstance(value, str):
        return ""
    try:
        number = float(value)
    except ValueError:
        return ""
    mantissa, _, exponent = repr(number).partition("e")
    if exponent:  # YAML 1.1 requires a point and a signed exponent
        mantissa = mantissa if "." in mantissa else f"{mantissa}.0"
        exponent = f"e{exponent}" if exponent[0] in "+-" else f"e+{exponent}"
    return f", which YAML reads as text; write {mantissa}{exponent}"


def as_whole_number(value: Any) -> int:
    """Convert to a whole number."""
    if isinstance(value, numbers.Integral) and not isinstance(value, bool | np.bool_):
        return int(value)
    raise RefusedValue(f"must be a whole number, not {format_value(value)}")


def as_boolean(value: Any) -> bool:
    """Convert to true or false."""
    if isinstance(value, bool):
        return value
    raise RefusedValue(f"must be true or false, not {format_value(value)}")


def as_text(value: Any) -> str:
    """Convert to text."""
    if isinstance(value, str):
        return value
    raise RefusedValue(f"must be text, not {format_value(value)}" + ("" if value is None else "; quote it"))


def as_path(value: Any) -> Path:
    """Convert to a path, which need not exist."""
    if isinstance(value, str | Path) and str(value):
        return Path(value)
    raise RefusedValue(f"must be a file path, not {format_value(value)}")


def as_one_of(value: Any, allowed: tuple[Any, ...]) -> Any:
    """Convert to one of the values of a Literal."""
    for each in allowed:
        if type(value) is type(each) and value == each:
            return each
    raise RefusedValue(f"must be {one_of(value, allowed)}, not {format_value(value)}")


def as_threads(value: Any) -> Any:
    """Convert to a number of threads, or auto."""
    if value != "auto" and (isinstance(value, bool) or not isinstance(value, int)):
        raise RefusedValue(f"must be auto or a whole number, not {value!r}")
    return value


def refuse_unknown(
    value: Mapping[Any, Any], allowed_keys: list[str], read_before: Sequence[str] = (), below: KeyPath = ()
) -> None:
    """Reject an unknown key of the mapping at the steps `below`; the message also lists keys read before."""
    for key in value:
        if key not in allowed_keys:
            allowed = known_names(key, [*allowed_keys, *read_before], "known keys:", whole=True)
            raise RefusedValue(f"unknown key; {allowed}", (*below, str(key)))


def as_material(value: Any) -> MaterialDescription:
    """Build a material from the keys of its law, or from the name of a preset and its changes.

    A parameter that is None counts as absent, by which overrides remove it.
    """
    if isinstance(value, str):
        value = {"preset": value}
    if not isinstance(value, Mapping):
        raise RefusedValue(
            f"must be the name of a preset or a mapping of parameters, not {format_value(value)}"
        )
    removable = {"prony", *(name for law in material_names() for name in material(law).names)}
    value = {key: each for key, each in value.items() if each is not None or key not in removable}
    law, preset = value.get("law"), value.get("preset")
    if preset is not None:
        law = _preset_law(preset, law)
    try:
        parameters = law_parameters(law)
    except FieldError as error:
        raise RefusedValue(f"must be {error.allowed}, not {format_value(law)}", ("law",)) from None
    except SceneError as error:
        raise RefusedValue(str(error), ("law",)) from None
    allowed_keys = ["law", "preset", "prony", *(each.name for each in parameters)]
    others = {
        key: [each for each in material_names() if key in material(each).names]
        for key in value
        if key not in allowed_keys
    }
    if others and all(others.values()):  # no key is misspelt
        key, laws = next(iter(others.items()))
        problem = f"is no parameter of the law {law or DEFAULT_LAW}, but of {listing(laws)}; set `law`"
        raise RefusedValue(problem, (str(key),))
    refuse_unknown(value, allowed_keys)
    values = {}
    for parameter in parameters:
        if parameter.name in value:
            values[parameter.name] = as_number(value[parameter.name], parameter.name)
        elif parameter.default is None and preset is None:
            raise RefusedValue("is missing; it has no default", (parameter.name,))
    return MaterialDescription(law=law, preset=preset, prony=_prony(value.get("prony", ())), **values)


def _prony(value: Any) -> tuple[tuple[float, float], ...]:
    """Convert shares and times of Prony terms."""
    if not isinstance(value, list | tuple):
        raise RefusedValue(
            f"must be a list of terms with share and time, not {format_value(value)}", ("prony",)
        )
    terms = []
    for i, term in enumerate(value):
        where = ("prony", i)
        if not isinstance(term, Mapping):
            raise RefusedValue(f"must have share and time, not {format_value(term)}", where)
        refuse_unknown(term, ["share", "time"], below=where)
        for name in ("share", "time"):
            if name not in term:
                raise RefusedValue("is missing; it has no default", (*where, name))
        terms.append((as_number(term["share"], *where, "share"), as_number(term["time"], *where, "time")))
    return tuple(terms)


def _preset_law(preset: Any, law: Any) -> str:
    """Return the law of a preset's constants."""
    if not isinstance(preset, str):
        raise RefusedValue(f"must be the name of a material, not {format_value(preset)}", ("preset",))
    if law is not None and not isinstance(law, str):
        raise RefusedValue(f"must be the name of a material law, not {format_value(law)}", ("law",))
    try:
        elastomer(preset)
    except SceneError as error:
        raise RefusedValue(str(error)) from None
    try:
        elastomer(preset).fit(law or DEFAULT_FIT)
    except SceneError as error:
        raise RefusedValue(str(error), ("law",)) from None
    return law or DEFAULT_FIT
