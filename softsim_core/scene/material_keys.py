"""Materials in scene files: a law with its parameters, or a preset and what differs from it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from softsim_core.errors import SceneError, listing
from softsim_core.fem.materials import material, material_names
from softsim_core.fem.materials.elastomers import DEFAULT_FIT, elastomer
from softsim_core.scene.material import DEFAULT_LAW, MaterialDescription, law_parameters
from softsim_core.scene.values_of_keys import RefusedValue, as_number, refuse_unknown, shown
from softsim_core.values import FieldError


def material_structure(value: Any, _: Any) -> MaterialDescription:
    """A material from the keys of its law, or from the name of a preset and what differs from it."""
    if isinstance(value, str):
        value = {"preset": value}
    if not isinstance(value, Mapping):
        raise RefusedValue(f"must be the name of a preset or a mapping of parameters, not {shown(value)}")
    law, preset = value.get("law"), value.get("preset")
    if preset is not None:
        law = _preset_law(preset, law)
    try:
        parameters = law_parameters(law)
    except FieldError as error:
        raise RefusedValue(f"must be {error.allowed}, not {shown(law)}", ("law",)) from None
    except SceneError as error:
        raise RefusedValue(str(error), ("law",)) from None
    known = ["law", "preset", "prony", *(each.name for each in parameters)]
    for key in value:
        if key in known:
            continue
        laws = [each for each in material_names() if key in material(each).names]
        misspelt = [
            each
            for each in value
            if each not in known and not any(each in material(name).names for name in material_names())
        ]
        if laws and not misspelt:
            problem = f"is no parameter of the law {law or DEFAULT_LAW}, but of {listing(laws)}; set `law`"
            raise RefusedValue(problem, (str(key),))
    refuse_unknown(value, known)
    values = {}
    for parameter in parameters:
        name = parameter.name
        if name not in value:
            if parameter.default is None and preset is None:
                raise RefusedValue("is missing; it has no default", (name,))
            continue
        try:
            values[name] = as_number(value[name], float)
        except RefusedValue as error:
            raise RefusedValue(error.problem, (name,)) from None
    return MaterialDescription(law=law, preset=preset, prony=_prony(value.get("prony", ())), **values)


def _prony(value: Any) -> tuple[tuple[float, float], ...]:
    """Shares and times of Prony terms."""
    if not isinstance(value, list | tuple):
        raise RefusedValue(f"must be a list of terms with share and time, not {shown(value)}", ("prony",))
    terms = []
    for i, term in enumerate(value):
        where = ("prony", i)
        if not isinstance(term, Mapping):
            raise RefusedValue(f"must have share and time, not {shown(term)}", where)
        try:
            refuse_unknown(term, ["share", "time"])
        except RefusedValue as error:
            raise RefusedValue(error.problem, (*where, *error.below)) from None
        numbers = {}
        for name in ("share", "time"):
            if name not in term:
                raise RefusedValue("is missing; it has no default", (*where, name))
            try:
                numbers[name] = as_number(term[name], float)
            except RefusedValue as error:
                raise RefusedValue(error.problem, (*where, name)) from None
        terms.append((numbers["share"], numbers["time"]))
    return tuple(terms)


def _preset_law(preset: Any, law: Any) -> str:
    """The law of a preset's constants."""
    if not isinstance(preset, str):
        raise RefusedValue(f"must be the name of a material, not {shown(preset)}", ("preset",))
    if law is not None and not isinstance(law, str):
        raise RefusedValue(f"must be the name of a material law, not {shown(law)}", ("law",))
    try:
        elastomer(preset)
    except SceneError as error:
        raise RefusedValue(str(error)) from None
    try:
        elastomer(preset).fit(law or DEFAULT_FIT)
    except SceneError as error:
        raise RefusedValue(str(error), ("law",)) from None
    return law or DEFAULT_FIT
