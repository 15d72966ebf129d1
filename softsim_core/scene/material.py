"""What a body is made of: a material law by name, and its parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NoReturn

from softsim_core.errors import SceneError, listing
from softsim_core.fem.materials import Material, MaterialParameter, material
from softsim_core.values import FieldError

DEFAULT_LAW = "corotational"
REFERENCE_LAW = "corotational_qr"
"""The law of bodies that name none, where the solver's rotation is "polar" and where it is "qr"."""


class MaterialDescription:
    """A material law and the values of its parameters, each an attribute by its name.

    `MaterialDescription(young_modulus=2e5, poisson_ratio=0.4)` is isotropic linear elasticity: Young modulus
    in [Pa], > 0; Poisson ratio in [-], in (-1, 0.5).

    Attributes:
        law: Name of the law, see fem.materials; None: "corotational", or "corotational_qr" where the solver's
            rotation is "qr".
        values: All parameters by name, in the order of the law; those not given have their defaults.

    Raises:
        FieldError: a value is missing, outside its interval, or does not fit the others.
        SceneError: the law is unknown, or it has no such parameter.
    """

    __slots__ = ("law", "values")

    law: str | None
    values: dict[str, float]

    def __init__(self, *, law: str | None = None, **values: float) -> None:
        object.__setattr__(self, "law", law)
        object.__setattr__(self, "values", _checked(_law_of(law), values))

    def law_for(self, rotation: str) -> Material:
        """The law, where bodies that name none have the solver's `rotation`, "polar" or "qr"."""
        return material(self.law or (REFERENCE_LAW if rotation == "qr" else DEFAULT_LAW))

    def changed(self, **values: float) -> MaterialDescription:
        """The same law with other values."""
        return MaterialDescription(law=self.law, **{**self.values, **values})

    def __getattr__(self, name: str) -> float:
        if name in self.__slots__ or name not in self.values:
            raise AttributeError(f"a material of the law {self.law or DEFAULT_LAW} has no {name!r}")
        return self.values[name]

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError("a material description does not change; `changed` makes another one")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, MaterialDescription) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())

    def __repr__(self) -> str:
        law = "" if self.law is None else f"law={self.law!r}, "
        values = ", ".join(f"{name}={value!r}" for name, value in self.values.items())
        return f"MaterialDescription({law}{values})"

    def __reduce__(self) -> tuple[Callable[..., MaterialDescription], tuple[str | None, dict[str, float]]]:
        return _described, (self.law, self.values)

    def _key(self) -> tuple[object, ...]:
        return (self.law, *self.values.items())

    def plain(self) -> dict[str, Any]:
        """The form that scene files have."""
        return ({} if self.law is None else {"law": self.law}) | self.values


def law_parameters(law: object) -> tuple[MaterialParameter, ...]:
    """A law's parameters; SceneError if `law` is no known law (None is the default one)."""
    return _law_of(law).parameters


def _described(law: str | None, values: Mapping[str, float]) -> MaterialDescription:
    return MaterialDescription(law=law, **values)


def _law_of(law: object) -> Material:
    if law is not None and not isinstance(law, str):
        raise FieldError("material", "law", law, "the name of a material law")
    return material(law or DEFAULT_LAW)


def _checked(law: Material, values: Mapping[str, float]) -> dict[str, float]:
    for name in values:
        if name not in law.names:
            known = listing(law.names)
            raise SceneError(f"material: the law {law.name} has no parameter {name!r}; known: {known}")
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
