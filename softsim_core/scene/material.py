"""Description of a material: a law by name, and its parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NoReturn

from softsim_core.base import FieldError, MaterialError, SceneError, known_names
from softsim_core.physics.fem.materials import (
    DEFAULT_FIT,
    SHARE,
    SILICONE_POISSON_RATIO,
    TIME,
    Material,
    MaterialParameter,
    elastomer,
    material,
    relaxing,
    stiffness_warning,
)

DEFAULT_LAW = "corotational"
REFERENCE_LAW = "corotational_qr"
"""Default law of bodies, for the solver's rotation "polar" and "qr"."""


class MaterialDescription:
    """A material law and the values of its parameters, which are also attributes by name.

    `MaterialDescription(young_modulus=2e5, poisson_ratio=0.4)` is isotropic linear elasticity: Young modulus
    in [Pa], > 0; Poisson ratio in [-], in (-1, 0.5). `MaterialDescription(preset="Dragon Skin 20",
    stiffness_factor=1.75)` has the constants of an elastomer of the table, except for those that are given.
    `prony=((0.1, 0.9),)` lets shares of the shear stress relax, each with its time in [s]; see
    fem.materials.relaxing. They are parameters, too: prony_share_1, prony_time_1 and so on.

    Attributes:
        law: Name of the law, see fem.materials; None: "corotational", or "corotational_qr" where the solver's
            rotation is "qr"; for a preset the law of its default fit.
        preset: Name of an elastomer, see fem.materials.elastomers, or None.
        terms: Number of Prony terms.
        values: All parameters by name, in the order of the law; those not given have their defaults.

    Raises:
        FieldError: a value is missing, outside its interval, or does not fit the others.
        SceneError: the law or the preset is unknown, or the law has no such parameter.
    """

    __slots__ = ("law", "preset", "terms", "values")

    law: str | None
    preset: str | None
    terms: int
    values: dict[str, float]

    def __init__(
        self,
        *,
        law: str | None = None,
        preset: str | None = None,
        prony: Sequence[tuple[float, float]] = (),
        **values: float,
    ) -> None:
        for i, (share, time) in enumerate(prony, start=1):
            values |= {f"{SHARE}_{i}": share, f"{TIME}_{i}": time}
        terms = sum(name.startswith(SHARE) for name in values)
        if preset is not None:
            law, preset = law or DEFAULT_FIT, elastomer(preset).name
            values = {**preset_values(preset, law), **values}
        object.__setattr__(self, "law", law)
        object.__setattr__(self, "preset", preset)
        object.__setattr__(self, "terms", terms)
        object.__setattr__(self, "values", _check_values(_law_of(law, terms), values))

    @property
    def known_density(self) -> float | None:
        """Mass per volume of the preset in [kg/m^3]; None: it is not known."""
        return None if self.preset is None else elastomer(self.preset).density

    @property
    def warning(self) -> str | None:
        """Warning about the preset's constants in this use, or None."""
        if self.preset is None or self.values["stiffness_factor"] != 1.0:
            return None
        return stiffness_warning(self.preset)

    def law_for(self, rotation: str) -> Material:
        """Return the law; `rotation`, "polar" or "qr", determines the default law."""
        return _law_of(self.law or (REFERENCE_LAW if rotation == "qr" else DEFAULT_LAW), self.terms)

    def with_values(self, **values: float) -> MaterialDescription:
        """Return the same law with other values."""
        return MaterialDescription(law=self.law, preset=self.preset, prony=(), **{**self.values, **values})

    def of_law(self, law: str) -> MaterialDescription:
        """Return the same values for another law with these parameters."""
        return MaterialDescription(law=law, preset=None, prony=(), **self.values)

    def __getattr__(self, name: str) -> float:
        if name in self.__slots__ or name not in self.values:
            raise AttributeError(f"a material of the law {self.law or DEFAULT_LAW} has no {name!r}")
        return self.values[name]

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError("a material description does not change; `with_values` makes another one")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, MaterialDescription) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())

    def __repr__(self) -> str:
        values = ", ".join(f"{name}={value!r}" for name, value in self.plain().items())
        return f"MaterialDescription({values})"

    def __reduce__(self) -> tuple[Callable[..., MaterialDescription], tuple[()]]:
        return partial(MaterialDescription, law=self.law, preset=self.preset, prony=(), **self.values), ()

    def _key(self) -> tuple[object, ...]:
        return (self.law, self.preset, *self.values.items())

    def plain(self) -> dict[str, Any]:
        """Return the material in the form of scene files."""
        law = {} if self.law is None else {"law": self.law}
        values, prony = dict(self.values), []
        for i in range(1, self.terms + 1):
            prony.append({"share": values.pop(f"{SHARE}_{i}"), "time": values.pop(f"{TIME}_{i}")})
        fading: dict[str, Any] = {"prony": prony} if prony else {}
        if self.preset is None:
            return law | values | fading
        own = preset_values(self.preset, self.law or DEFAULT_FIT)
        changed = {name: value for name, value in values.items() if value != own[name]}
        return {"preset": self.preset} | ({} if self.law == DEFAULT_FIT else law) | changed | fading


def law_parameters(law: object) -> tuple[MaterialParameter, ...]:
    """Return a law's parameters; raise SceneError if `law` is unknown (None is the default one)."""
    return _law_of(law).parameters


def preset_values(preset: str, law: str) -> dict[str, float]:
    """Return all parameters of an elastomer's law; raise SceneError if one of them is not known."""
    constants = elastomer(preset).fit(law).constants
    return material(law).values({"poisson_ratio": SILICONE_POISSON_RATIO, **constants})


def _law_of(law: object, terms: int = 0) -> Material:
    if law is not None and not isinstance(law, str):
        raise FieldError("material", "law", law, "the name of a material law")
    found = material(law or DEFAULT_LAW)
    if not terms:
        return found
    try:
        return relaxing(found, terms)
    except MaterialError as error:
        raise SceneError(f"material: {error}") from error


def _check_values(law: Material, values: Mapping[str, float]) -> dict[str, float]:
    for name in values:
        if name not in law.names:
            hint = known_names(name, law.names)
            raise SceneError(f"material: the law {law.name} has no parameter {name!r}; {hint}")
    complete = {}
    for parameter in law.parameters:
        value = values.get(parameter.name, parameter.default)
        if value is None:
            raise FieldError("material", parameter.name, "missing", parameter.allowed)
        if not parameter.lower < value < parameter.upper:  # also rejects NaN
            raise FieldError("material", parameter.name, value, parameter.allowed)
        complete[parameter.name] = float(value)
    if refused := law.refusal(complete):
        raise FieldError("material", refused.name, complete[refused.name], refused.allowed)
    return complete
