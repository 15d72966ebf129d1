"""Basic values of scene descriptions: vectors, placements, regions, and their checks."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final, Literal, NewType, TypeAlias

from softsim_core.base.arrays import Array
from softsim_core.base.errors import SceneError

Vector: TypeAlias = tuple[float, float, float]
Backend: TypeAlias = Literal["auto", "numba", "scipy"]
"""Implementation of the step: compiled, in plain NumPy and SciPy, or the first of them that is installed."""

SceneName = NewType("SceneName", str)
"""Name of a robot or scene, or its file as text or Path."""

POINT: Final = MappingProxyType({"in_world": "point"})
"""Metadata of a field of vectors: points in the world at the time the scene is built; see scene.placed."""

DIRECTION: Final = MappingProxyType({"in_world": "direction"})
"""Metadata of a field of vectors: directions or velocities in the axes of the world."""

LOCAL: Final = MappingProxyType({"in_world": "no"})
"""Metadata of a field with a placement or a region in the frame of another part."""


def vector(values: Array) -> Vector:
    """Return an array of three numbers as a tuple of floats."""
    x, y, z = values.tolist()
    return x, y, z


class FieldError(SceneError):
    """A field of a description is out of range; carries the field's name, for loaders to name the key."""

    def __init__(self, owner: str, field: str, value: object, allowed: str) -> None:
        self.field, self.value, self.allowed = field, value, allowed
        super().__init__(f"{owner}: {field} must be {allowed}, not {value}")


def need_positive(owner: str, field: str, value: float, unit: str) -> None:
    """Raise FieldError unless a value is > 0 and finite."""
    if not 0.0 < value < math.inf:  # also rejects NaN
        raise FieldError(owner, field, value, f"> 0 {unit}".rstrip())


def need_not_negative(owner: str, field: str, value: float, unit: str) -> None:
    """Raise FieldError unless a value is >= 0 and finite."""
    if not 0.0 <= value < math.inf:  # also rejects NaN
        raise FieldError(owner, field, value, f">= 0 {unit}".rstrip())


def need_finite(owner: str, field: str, values: tuple[float, ...]) -> None:
    """Raise FieldError unless all values are finite."""
    if not all(math.isfinite(value) for value in values):
        raise FieldError(owner, field, list(values), "finite")


def need_unit(owner: str, field: str, axis: Vector) -> None:
    """Raise FieldError unless an axis has length 1."""
    if not math.isclose(math.hypot(*axis), 1.0, rel_tol=1e-6):  # also rejects NaN and infinity
        raise FieldError(owner, field, list(axis), "a direction of length 1")


@dataclass(frozen=True, slots=True, kw_only=True)
class Placement:
    """Placement: scale, then rotate about fixed x, then y, then z, then translate.

    Attributes:
        scale: Factor from file units to [m] (0.001 for a file in millimetres), > 0.
        rotation_deg: Angles about the fixed x, y, z axes in [deg], applied in that order.
        translation: Shift in [m].
    """

    scale: float = 1.0
    rotation_deg: Vector = (0.0, 0.0, 0.0)
    translation: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        need_positive("placement", "scale", self.scale, "")
        need_finite("placement", "rotation_deg", self.rotation_deg)
        need_finite("placement", "translation", self.translation)


@dataclass(frozen=True, slots=True, kw_only=True)
class MeshFile:
    """A mesh file and its placement; a relative path is relative to the file that names it."""

    file: Path
    placement: Placement = Placement()


@dataclass(frozen=True, slots=True, kw_only=True)
class Box:
    """Region inside an oriented box, faces included: centre and full size in [m], rotated as in Placement."""

    center: Vector
    size: Vector
    rotation_deg: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        need_finite("box", "center", self.center)
        need_finite("box", "rotation_deg", self.rotation_deg)
        if not all(0.0 < edge < math.inf for edge in self.size):
            raise FieldError("box", "size", list(self.size), "three lengths > 0 m")


@dataclass(frozen=True, slots=True, kw_only=True)
class Sphere:
    """Region inside a sphere, surface included: centre and radius in [m]."""

    center: Vector
    radius: float

    def __post_init__(self) -> None:
        need_finite("sphere", "center", self.center)
        need_positive("sphere", "radius", self.radius, "m")
