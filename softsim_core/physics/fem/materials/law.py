r"""Definition of a material law: energy, first Piola stress and tangent at deformation gradients.

With the energy density :math:`\Psi(F)` in [J/m^3] of the rest volume,

.. math:: P = \partial \Psi / \partial F, \qquad C_{ijkl} = \partial P_{ij} / \partial F_{kl} .

All methods take deformation gradients F, shape (..., 3, 3), and parameter values p, shape (..., k), in the
order of `parameters`; the leading dimensions broadcast.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from math import inf
from typing import Any, ClassVar, NamedTuple

import numpy as np

from softsim_core.base import Array, FactorisationError, MaterialError, SceneError, known_names
from softsim_core.physics.kernels import why_plain


@dataclass(frozen=True, slots=True)
class MaterialParameter:
    """A parameter of a law.

    Attributes:
        name: Name used in scenes.
        unit: Unit such as "Pa" or "s"; "-" for a number without one.
        description: Meaning in one phrase.
        lower, upper: Open interval of allowed values.
        default: Value if the scene gives none; None: the scene must give one.
    """

    name: str
    unit: str
    description: str
    lower: float = -inf
    upper: float = inf
    default: float | None = None

    @property
    def allowed(self) -> str:
        """Allowed values, for messages."""
        unit = "" if self.unit == "-" else f" {self.unit}"
        if self.upper == inf:
            return "finite" if self.lower == -inf else f"> {self.lower:g}{unit}"
        if self.lower == -inf:
            return f"< {self.upper:g}{unit}"
        return f"between {self.lower:g} and {self.upper:g}{unit} (both excluded)"


class Refusal(NamedTuple):
    """Reason why values that lie in their intervals are inconsistent.

    Attributes:
        name: Parameter to change.
        allowed: Allowed values of it, given the others.
    """

    name: str
    allowed: str


class TangentModes(NamedTuple):
    """A symmetric tangent as a multiple of the identity plus a few modes, C = c I + sum_k w_k M_k M_k^T.

    Attributes:
        isotropic: c in [Pa], shape (...).
        weights: w in [Pa], shape (..., k).
        modes: M, each a dF, shape (..., k, 3, 3).
    """

    isotropic: Array
    weights: Array
    modes: Array

    def dense(self) -> Array:
        """Return C, shape (..., 3, 3, 3, 3)."""
        modes = self.modes.reshape(*self.modes.shape[:-2], 9)
        weighted = self.weights[..., None] * modes
        tangent = np.swapaxes(weighted, -1, -2) @ modes + self.isotropic[..., None, None] * np.eye(9)
        return np.asarray(tangent.reshape(*tangent.shape[:-2], 3, 3, 3, 3))


class Material(ABC):
    """A material law; a new one implements `stress` and `tangent`, and `energy` where it has a potential.

    Attributes:
        name: Name used in scenes.
        parameters: Its parameters, in the order of the values p.
        has_potential: Whether P is the derivative of `energy`; then the tangent is symmetric.
        in_cell_axes: Whether F is taken in the axes of each cell (its first edge, the plane of its first
            three nodes) instead of the scene's; F at rest is then that frame, not the identity.
        stress_and_tangent: A static function (F, p, P, C) in the part of Python that Numba compiles, or None.
            It sets P (3, 3) and C (3, 3, 3, 3), which are zero before, at one F (3, 3) for values p (k,);
            all are arrays of float64. With it the step assembles the law in compiled code, else by `stress`
            and `tangent`. It is for laws with a potential that do not separate shear from volume; see
            `PointLaw`. Loops compile in less than a second, products such as F @ F.T in several.
    """

    name: ClassVar[str]
    parameters: ClassVar[tuple[MaterialParameter, ...]]
    has_potential: ClassVar[bool] = True
    in_cell_axes: ClassVar[bool] = False
    stress_and_tangent: ClassVar[Any] = None

    @abstractmethod
    def energy(self, deformation: Array, p: Array) -> Array:
        """Return the energy density in [J/m^3], shape (...)."""

    @abstractmethod
    def stress(self, deformation: Array, p: Array) -> Array:
        """Return the first Piola stress in [Pa], shape (..., 3, 3)."""

    @abstractmethod
    def tangent(self, deformation: Array, p: Array) -> Array:
        """Return the exact tangent dP_ij / dF_kl in [Pa], shape (..., 3, 3, 3, 3)."""

    def positive_tangent(self, deformation: Array, p: Array) -> Array:
        """Return the tangent for a time step: symmetric, without negative eigenvalues, shaped as `tangent`.

        By default, the negative eigenvalues of the symmetric part are set to zero. A law may override it with
        a cheaper method. Source: Teran et al. 2005, Robust quasistatic finite elements and flesh simulation.

        Raises:
            FactorisationError: a deformation is not finite.
        """
        return clamp_tangent(self.tangent(deformation, p))

    def positive_modes(self, deformation: Array, p: Array) -> TangentModes | None:
        """Return the positive tangent as modes, which are cheaper to assemble.

        None: the law has no such form.
        """
        return None

    def distant_tangent(self, deformation: Array, p: Array) -> Array:
        """Return a positive tangent for statics far from an equilibrium, such as a crumpled start."""
        return self.positive_tangent(deformation, p)

    def cauchy_stress(self, deformation: Array, stress: Array) -> Array:
        """Return the symmetric stress P F^T / det F in world axes in [Pa], shape (..., 3, 3).

        `stress` is the first Piola stress P, shape (..., 3, 3).
        """
        turned = stress @ np.swapaxes(deformation, -1, -2)
        return np.asarray(turned / np.linalg.det(deformation)[..., None, None])

    def refusal(self, values: Mapping[str, float]) -> Refusal | None:
        """Return why values, each of them in its interval, are inconsistent; None if they are consistent."""
        return None

    def values(self, constants: Mapping[str, float]) -> dict[str, float]:
        """Return checked values of all parameters, in order.

        Parameters that are not given take their defaults.

        Raises:
            MaterialError: a parameter is unknown, missing, outside its interval or inconsistent with the
                others.
        """
        for name in constants:
            if name not in self.names:
                problem = f"is unknown to the law {self.name}; {known_names(name, self.names)}"
                raise MaterialError(name, constants[name], problem)
        values = {}
        for parameter in self.parameters:
            value = constants.get(parameter.name, parameter.default)
            if value is None:
                raise MaterialError(parameter.name, "nothing", f"is missing; it must be {parameter.allowed}")
            if not (parameter.lower < value < parameter.upper):  # also rejects NaN
                raise MaterialError(parameter.name, value, f"must be {parameter.allowed}")
            values[parameter.name] = float(value)
        if refused := self.refusal(values):
            raise MaterialError(refused.name, values[refused.name], f"must be {refused.allowed}")
        return values

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in order."""
        return tuple(parameter.name for parameter in self.parameters)


class PointLaw(Material):
    """A law that is written once, as `energy` and the function `stress_and_tangent` at one point."""

    def stress(self, deformation: Array, p: Array) -> Array:
        """Return the first Piola stress in [Pa], shape (..., 3, 3)."""
        return self._at_points(deformation, p)[0]

    def tangent(self, deformation: Array, p: Array) -> Array:
        """Return the tangent dP_ij / dF_kl in [Pa], shape (..., 3, 3, 3, 3)."""
        return self._at_points(deformation, p)[1]

    def _at_points(self, deformation: Array, p: Array) -> tuple[Array, Array]:
        shape = np.broadcast_shapes(deformation.shape[:-2], p.shape[:-1])
        f = np.broadcast_to(deformation, (*shape, 3, 3)).reshape(-1, 3, 3)
        values = np.broadcast_to(p, (*shape, p.shape[-1])).reshape(len(f), -1)
        stress, tangent = np.zeros((len(f), 3, 3)), np.zeros((len(f), 3, 3, 3, 3))
        compile_points(self)(np.ascontiguousarray(f), np.ascontiguousarray(values), stress, tangent)
        return stress.reshape(*shape, 3, 3), tangent.reshape(*shape, 3, 3, 3, 3)


def compile_points(law: Material) -> Callable[[Array, Array, Array, Array], None]:
    """Return `stress_and_tangent` of a law over points (m, ...), compiled where kernels are.

    Raises:
        SceneError: Numba does not compile it.
    """
    return _over_points(law.stress_and_tangent, law.name)


@cache
def _over_points(at_point: Any, name: str) -> Callable[[Array, Array, Array, Array], None]:
    """Return a function of one point over points (m, ...)."""

    def at_points(f: Array, p: Array, stress: Array, tangent: Array) -> None:
        for i in range(len(f)):
            at_point(f[i], p[i], stress[i], tangent[i])

    if why_plain():
        return at_points
    from numba import float64, njit
    from numba.core.errors import NumbaError

    try:
        at_point = njit(nogil=True, error_model="numpy")(at_point)
        compiled = njit(nogil=True, error_model="numpy")(at_points)
        compiled.compile((float64[:, :, ::1], float64[:, ::1], float64[:, :, ::1], float64[:, :, :, :, ::1]))
    except (NumbaError, TypeError) as error:
        reason = " ".join(re.sub(r"\x1b\[[0-9;]*m", "", str(error)).split())  # without colours
        raise SceneError(
            f"stress_and_tangent of the law {name} must be Python that Numba compiles: {reason[:400]}"
        ) from error
    return compiled


class VolumetricMaterial(Material):
    r"""A law whose energy separates into a shear part and a volumetric part.

    .. math:: \Psi = \Psi_s(F) + \tfrac{a}{2} \theta(F)^2

    with a measure :math:`\theta` of the change of volume, zero at rest, and the bulk coefficient a. Elements
    in which part of a acts on the mean volume (Element.mean_volume) do not lock, however large a is; the
    pressure at a point is then :math:`p = a_p \theta + (a - a_p) \bar\theta`.
    """

    @abstractmethod
    def bulk(self, p: Array) -> Array:
        """Return the bulk coefficient a in [Pa], shape (...)."""

    @abstractmethod
    def point_bulk(self, p: Array, ratio: float = 1.0) -> Array:
        """Return the part a_p of a in [Pa] that acts at each point, shape (...).

        It is the coefficient a for lambda = `ratio` mu, but at most a; see Element.point_ratio.
        """

    @abstractmethod
    def dilatation(self, deformation: Array) -> Array:
        """Return theta, shape (...)."""

    @abstractmethod
    def dilatation_slope(self, deformation: Array) -> Array:
        """Return d theta / dF, shape (..., 3, 3)."""

    @abstractmethod
    def shear_energy(self, deformation: Array, p: Array) -> Array:
        """Return Psi_s in [J/m^3], shape (...)."""

    @abstractmethod
    def shear_stress(self, deformation: Array, p: Array) -> Array:
        """Return d Psi_s / dF in [Pa], shape (..., 3, 3)."""

    @abstractmethod
    def tangent_at(self, deformation: Array, p: Array, bulk: Array, pressure: Array) -> Array:
        """Return Psi_s'' + bulk theta' theta' + pressure theta'' in [Pa], shape (..., 3, 3, 3, 3).

        Args:
            deformation: Deformation gradients, shape (..., 3, 3).
            p: Parameter values, shape (..., k).
            bulk: Part of a that acts at the point in [Pa], shape (...).
            pressure: Pressure at the point in [Pa], shape (...).
        """

    def positive_tangent_at(self, deformation: Array, p: Array, bulk: Array, pressure: Array) -> Array:
        """Return the tangent of `tangent_at` without negative eigenvalues; see `positive_tangent`."""
        return clamp_tangent(self.tangent_at(deformation, p, bulk, pressure))

    def energy(self, deformation: Array, p: Array) -> Array:
        """Return the energy density Psi_s + a/2 theta^2 in [J/m^3], shape (...)."""
        volumetric = 0.5 * self.bulk(p) * self.dilatation(deformation) ** 2
        return np.asarray(self.shear_energy(deformation, p) + volumetric)

    def stress(self, deformation: Array, p: Array) -> Array:
        """Return the first Piola stress, shear part plus a theta theta', in [Pa], shape (..., 3, 3)."""
        pressure = self.bulk(p) * self.dilatation(deformation)
        slope = self.dilatation_slope(deformation)
        return np.asarray(self.shear_stress(deformation, p) + pressure[..., None, None] * slope)

    def tangent(self, deformation: Array, p: Array) -> Array:
        """Return the exact tangent at bulk a and pressure a theta in [Pa], shape (..., 3, 3, 3, 3)."""
        bulk = self.bulk(p)
        return self.tangent_at(deformation, p, bulk, bulk * self.dilatation(deformation))

    def positive_tangent(self, deformation: Array, p: Array) -> Array:
        """Return the positive tangent at bulk a and pressure a theta in [Pa], shape (..., 3, 3, 3, 3)."""
        bulk = self.bulk(p)
        return self.positive_tangent_at(deformation, p, bulk, bulk * self.dilatation(deformation))


def clamp_tangent(tangent: Array) -> Array:
    """Return the symmetric part of tangents (..., 3, 3, 3, 3) with negative eigenvalues set to zero.

    Raises:
        FactorisationError: a tangent is not finite.
    """
    matrix = tangent.reshape(*tangent.shape[:-4], 9, 9)
    if not np.isfinite(matrix).all():
        raise FactorisationError("the deformation of an element is not finite")
    values, vectors = np.linalg.eigh(0.5 * (matrix + np.swapaxes(matrix, -1, -2)))
    positive = (vectors * np.maximum(values, 0.0)[..., None, :]) @ np.swapaxes(vectors, -1, -2)
    return np.asarray(positive.reshape(tangent.shape))


def von_mises(stress: Array) -> Array:
    """Return the von Mises stress in [Pa] of stress tensors (..., 3, 3), shape (...)."""
    deviator = stress - np.trace(stress, axis1=-2, axis2=-1)[..., None, None] / 3.0 * np.eye(3)
    return np.asarray(np.sqrt(1.5 * np.einsum("...ij,...ij->...", deviator, deviator)))


YOUNG_MODULUS = MaterialParameter("young_modulus", "Pa", "Young modulus", 0.0, inf)
POISSON_RATIO = MaterialParameter("poisson_ratio", "-", "Poisson ratio", -1.0, 0.5)
HOOKE = (YOUNG_MODULUS, POISSON_RATIO)
"""Parameters of a law that equals Hooke's at small strain."""
STIFFNESS_FACTOR = MaterialParameter(
    "stiffness_factor", "-", "Factor on the stiffness, from a test of your own", 0.0, inf, default=1.0
)
"""Scales all constants of a curve of known shape and uncertain magnitude."""


def lame(p: Array) -> tuple[Array, Array]:
    """Return the Lame parameters (lambda, mu) in [Pa], shapes (...), for values (..., 2) of HOOKE."""
    young, poisson = p[..., 0], p[..., 1]
    return young * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson)), young / (2.0 * (1.0 + poisson))


def first_lame(shear: Array, poisson: Array) -> Array:
    """Return Lame's lambda in [Pa] for a shear modulus in [Pa] and a Poisson ratio, shapes (...)."""
    return np.asarray(2.0 * shear * poisson / (1.0 - 2.0 * poisson))
