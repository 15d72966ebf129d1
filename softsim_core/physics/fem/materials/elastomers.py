"""Elastomers by name, with measured tension curves and the laws fitted to them (elastomers.yaml)."""

from __future__ import annotations

import functools
import importlib
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from softsim_core.base import Array, SceneError, known_names
from softsim_core.physics.fem.materials.law import Material

_HALVINGS = 60


def tension(law: Material, p: Array, stretches: Array) -> tuple[Array, Array]:
    """Return the transverse stretches and the nominal axial stresses in [Pa] of a bar, shapes (k,).

    Args:
        law: An isotropic law.
        p: Values of its parameters, shape (parameters,).
        stretches: Axial stretches of the bar in [-], > 0, shape (k,); below 1 in compression.
    """
    low, high = np.full(stretches.shape, 1e-3), np.maximum(3.0, 2.0 / np.sqrt(stretches))
    for _ in range(_HALVINGS):
        across = 0.5 * (low + high)
        is_thin = law.stress(_bar(stretches, across), p)[..., 1, 1] < 0.0
        low, high = np.where(is_thin, across, low), np.where(is_thin, high, across)
    return across, np.asarray(law.stress(_bar(stretches, across), p)[..., 0, 0])


def _bar(along: Array, across: Array) -> Array:
    deformation = np.zeros((*along.shape, 3, 3))
    deformation[..., 0, 0], deformation[..., 1, 1], deformation[..., 2, 2] = along, across, across
    return deformation


class RestStiffness(NamedTuple):
    """Moduli of an isotropic law at rest: Young, shear and bulk modulus in [Pa], Poisson ratio in [-]."""

    young: float
    shear: float
    bulk: float
    poisson: float

    def bar_speed(self, density: float) -> float:
        """Return the speed in [m/s] of a longitudinal wave in a slender bar of that density in [kg/m^3]."""
        return math.sqrt(self.young / density)

    def shear_speed(self, density: float) -> float:
        """Return the speed in [m/s] of a shear wave."""
        return math.sqrt(self.shear / density)

    def pressure_speed(self, density: float) -> float:
        """Return the speed in [m/s] of a pressure wave, the fastest one in nearly incompressible material."""
        return math.sqrt((self.bulk + 4.0 / 3.0 * self.shear) / density)


def rest_stiffness(law: Material, p: Array) -> RestStiffness:
    """Return the moduli of a law with parameter values p, from its tangent at rest."""
    tangent = law.tangent(np.eye(3), p)
    shear, along = float(tangent[0, 1, 0, 1]), float(tangent[0, 0, 0, 0])
    bulk = along - 4.0 / 3.0 * shear
    young = 9.0 * bulk * shear / (3.0 * bulk + shear)
    return RestStiffness(young, shear, bulk, (3.0 * bulk - 2.0 * shear) / (6.0 * bulk + 2.0 * shear))


TABLE = Path(__file__).with_name("elastomers.yaml")
FITTED_LAWS = ("yeoh", "ogden")
DEFAULT_FIT = "yeoh"
"""Law of an elastomer for which the scene names none."""
SILICONE_POISSON_RATIO = 0.499
"""Default Poisson ratio in [-] of an elastomer: silicone is nearly incompressible."""
MEASURED_FACTOR = 1.75
"""Measured over tabulated stiffness of Dragon Skin 10, from a bent beam."""


@dataclass(frozen=True, slots=True)
class Fit:
    """A law fitted to a tension curve.

    Attributes:
        constants: Parameters of the law by name.
        to_stretch: Stretch in [-] up to which it is fitted.
    """

    constants: Mapping[str, float]
    to_stretch: float


@dataclass(frozen=True, slots=True, eq=False)
class Elastomer:
    """A measured elastomer.

    Attributes:
        name: Its name.
        density: Density in [kg/m^3]; None: unknown.
        break_stretch: Stretch in [-] at which the specimen broke.
        fits: Fitted laws by name.
        points: Stretch in [-] and nominal stress in [Pa], shape (k, 2).
        source: Where the curve comes from, and its licence.
    """

    name: str
    density: float | None
    break_stretch: float
    fits: Mapping[str, Fit]
    points: Array
    source: str

    def fit(self, law: str) -> Fit:
        """Return the fit of a law.

        Raises:
            SceneError: there is none; the message lists the fitted laws.
        """
        if law not in self.fits:
            hint = known_names(law, self.fits, "fitted:")
            raise SceneError(f"{self.name}: no constants for the law {law!r}; {hint}")
        return self.fits[law]


def elastomer(name: str) -> Elastomer:
    """Return the elastomer of that name; case, blanks, hyphens and underscores are ignored.

    Raises:
        SceneError: there is none; the message lists similar names.
    """
    table = _table()
    if found := table.get(_plain(name)):
        return found
    near = known_names(name, (each.name for each in table.values()), lists_all="softsim material")
    raise SceneError(f"unknown material {name[:60]!r}; {near}")


def elastomer_names() -> tuple[str, ...]:
    """Return the names of all elastomers, sorted."""
    return tuple(sorted(each.name for each in _table().values()))


def stiffness_warning(name: str) -> str:
    """Return the warning that the table's stiffness of an elastomer is too low."""
    return (
        f"the table's stiffness of {name} is too low, its strain being the travel of the test machine; set "
        f"stiffness_factor from a test of your own ({MEASURED_FACTOR:g} was measured for Dragon Skin 10)"
    )


def _plain(name: str) -> str:
    return re.sub(r"[\s_-]+", "", name).casefold()


@functools.lru_cache(maxsize=1)
def _table() -> dict[str, Elastomer]:
    data = importlib.import_module("yaml").safe_load(TABLE.read_text(encoding="utf-8"))
    found = {}
    for row in data["materials"]:
        fits = {law: _fit(row[law]) for law in FITTED_LAWS}
        points = np.array(row["points"], dtype=float) * (1.0, 1e3)
        found[_plain(row["name"])] = Elastomer(
            row["name"], row.get("density"), float(row["break_stretch"]), fits, points, data["source"]
        )
    return found


def _fit(row: Mapping[str, float]) -> Fit:
    constants = {name: float(value) for name, value in row.items() if name != "to_stretch"}
    return Fit(constants, float(row["to_stretch"]))
