r"""What a material law is: energy, first Piola stress and tangent at deformation gradients.

With the energy density :math:`\Psi(F)` in [J/m^3] of the rest volume,

.. math:: P = \partial \Psi / \partial F, \qquad C_{ijkl} = \partial P_{ij} / \partial F_{kl} .

All methods take deformation gradients F, shape (..., 3, 3), and parameter values p, shape (..., k), in the
order of `parameters`; the shapes in front broadcast.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from math import inf
from typing import ClassVar, NamedTuple

import numpy as np

from softsim_core.base import Array, FactorisationError, MaterialError, known_names


@dataclass(frozen=True, slots=True)
class MaterialParameter:
    """A parameter of a law.

    Attributes:
        name: By which scenes name it.
        unit: "Pa", "s"; "-" for a number without one.
        description: One phrase.
        lower, upper: It lies between them, both excluded.
        default: Its value where none is given; None: it has to be given.
    """

    name: str
    unit: str
    description: str
    lower: float = -inf
    upper: float = inf
    default: float | None = None

    @property
    def allowed(self) -> str:
        """What is allowed, for messages."""
        unit = "" if self.unit == "-" else f" {self.unit}"
        if self.upper == inf:
            return "finite" if self.lower == -inf else f"> {self.lower:g}{unit}"
        if self.lower == -inf:
            return f"< {self.upper:g}{unit}"
        return f"between {self.lower:g} and {self.upper:g}{unit} (both excluded)"


class Refusal(NamedTuple):
    """Why values that lie in their intervals do not fit together.

    Attributes:
        name: Parameter to change.
        allowed: What is allowed for it, beside the others.
    """

    name: str
    allowed: str


class TangentModes(NamedTuple):
    """A symmetric tangent as a multiple of the identity and few modes, C = c I + sum_k w_k M_k M_k^T.

    Attributes:
        isotropic: c in [Pa], shape (...).
        weights: w in [Pa], shape (..., k).
        modes: M, each a dF, shape (..., k, 3, 3).
    """

    isotropic: Array
    weights: Array
    modes: Array

    def dense(self) -> Array:
        """C, shape (..., 3, 3, 3, 3)."""
        modes = self.modes.reshape(*self.modes.shape[:-2], 9)
        weighted = self.weights[..., None] * modes
        tangent = np.swapaxes(weighted, -1, -2) @ modes + self.isotropic[..., None, None] * np.eye(9)
        return np.asarray(tangent.reshape(*tangent.shape[:-2], 3, 3, 3, 3))


class Material(ABC):
    """A material law; a new one implements `stress` and `tangent`, and `energy` where it has a potential.

    Attributes:
        name: By which scenes name it.
        parameters: Its parameters, in the order of the values p.
        has_potential: Whether P is the derivative of `energy`; then the tangent is symmetric.
        in_cell_axes: Whether F is to be taken from axes of each cell (its first edge, the plane of its first
            three nodes) instead of the scene's; F at rest is then that frame, not the identity.
    """

    name: ClassVar[str]
    parameters: ClassVar[tuple[MaterialParameter, ...]]
    has_potential: ClassVar[bool] = True
    in_cell_axes: ClassVar[bool] = False

    @abstractmethod
    def energy(self, deformation: Array, p: Array) -> Array:
        """Energy density in [J/m^3], shape (...)."""

    @abstractmethod
    def stress(self, deformation: Array, p: Array) -> Array:
        """First Piola stress in [Pa], shape (..., 3, 3)."""

    @abstractmethod
    def tangent(self, deformation: Array, p: Array) -> Array:
        """dP_ij / dF_kl in [Pa], exact, shape (..., 3, 3, 3, 3)."""

    def positive_tangent(self, deformation: Array, p: Array) -> Array:
        """The tangent that a time step solves with: symmetric, without negative eigenvalues; as `tangent`.

        This one sets the negative eigenvalues of the symmetric part to zero. A law may know a quicker way.
        Source: Teran et al. 2005, Robust quasistatic finite elements and flesh simulation.

        Raises:
            FactorisationError: a deformation is not finite.
        """
        return clamped(self.tangent(deformation, p))

    def positive_modes(self, deformation: Array, p: Array) -> TangentModes | None:
        """The same as modes, which are quicker to put on nodes; None: the law does not know them."""
        return None

    def distant_tangent(self, deformation: Array, p: Array) -> Array:
        """A positive tangent for statics far from an equilibrium, such as a crumpled start; as `tangent`."""
        return self.positive_tangent(deformation, p)

    def cauchy_stress(self, deformation: Array, stress: Array) -> Array:
        """Stress in world axes in [Pa], symmetric, of a first Piola stress P: P F^T / det F, (..., 3, 3)."""
        turned = stress @ np.swapaxes(deformation, -1, -2)
        return np.asarray(turned / np.linalg.det(deformation)[..., None, None])

    def refusal(self, values: Mapping[str, float]) -> Refusal | None:
        """Why values of all parameters, each in its interval, do not fit together; None if they do."""
        return None

    def values(self, given: Mapping[str, float]) -> dict[str, float]:
        """Checked values of all parameters, in order; those not given have their defaults.

        Raises:
            MaterialError: a parameter is unknown, missing, outside its interval or does not fit the others.
        """
        for name in given:
            if name not in self.names:
                known = f"is unknown to the law {self.name}; {known_names(name, self.names)}"
                raise MaterialError(name, given[name], known)
        values = {}
        for parameter in self.parameters:
            value = given.get(parameter.name, parameter.default)
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


class VolumetricMaterial(Material):
    r"""A law whose answer to volume can be taken apart from its answer to shear.

    .. math:: \Psi = \Psi_s(F) + \tfrac{a}{2} \theta(F)^2

    with a measure :math:`\theta` of the change of volume, zero at rest, and the bulk coefficient a. Elements
    that take part of a on their mean volume (Element.mean_volume) do not lock however large it is; what then
    stands at a point is the pressure :math:`p = a_p \theta + (a - a_p) \bar\theta`.
    """

    @abstractmethod
    def bulk(self, p: Array) -> Array:
        """The coefficient a in [Pa], shape (...)."""

    @abstractmethod
    def point_bulk(self, p: Array) -> Array:
        """The part a_p of it in [Pa] that stays at each point: that of lambda = mu, at most a."""

    @abstractmethod
    def dilatation(self, deformation: Array) -> Array:
        """Theta, shape (...)."""

    @abstractmethod
    def dilatation_slope(self, deformation: Array) -> Array:
        """D theta / dF, shape (..., 3, 3)."""

    @abstractmethod
    def shear_energy(self, deformation: Array, p: Array) -> Array:
        """Psi_s in [J/m^3], shape (...)."""

    @abstractmethod
    def shear_stress(self, deformation: Array, p: Array) -> Array:
        """D Psi_s / dF in [Pa], shape (..., 3, 3)."""

    @abstractmethod
    def tangent_at(self, deformation: Array, p: Array, bulk: Array, pressure: Array) -> Array:
        """D^2 Psi_s + bulk theta' theta' + pressure theta'' in [Pa], shape (..., 3, 3, 3, 3).

        Args:
            deformation: See the module.
            p: See the module.
            bulk: The part of a that stands at the point in [Pa], shape (...).
            pressure: The pressure that holds there in [Pa], shape (...).
        """

    def positive_tangent_at(self, deformation: Array, p: Array, bulk: Array, pressure: Array) -> Array:
        """As `tangent_at`, without negative eigenvalues; see `positive_tangent`."""
        return clamped(self.tangent_at(deformation, p, bulk, pressure))

    def energy(self, deformation: Array, p: Array) -> Array:
        """See Material."""
        volumetric = 0.5 * self.bulk(p) * self.dilatation(deformation) ** 2
        return np.asarray(self.shear_energy(deformation, p) + volumetric)

    def stress(self, deformation: Array, p: Array) -> Array:
        """See Material."""
        pressure = self.bulk(p) * self.dilatation(deformation)
        slope = self.dilatation_slope(deformation)
        return np.asarray(self.shear_stress(deformation, p) + pressure[..., None, None] * slope)

    def tangent(self, deformation: Array, p: Array) -> Array:
        """See Material."""
        bulk = self.bulk(p)
        return self.tangent_at(deformation, p, bulk, bulk * self.dilatation(deformation))

    def positive_tangent(self, deformation: Array, p: Array) -> Array:
        """See Material."""
        bulk = self.bulk(p)
        return self.positive_tangent_at(deformation, p, bulk, bulk * self.dilatation(deformation))


def clamped(tangent: Array) -> Array:
    """Symmetric tangents (..., 3, 3, 3, 3) with their negative eigenvalues set to zero.

    Raises:
        FactorisationError: one is not finite.
    """
    matrix = tangent.reshape(*tangent.shape[:-4], 9, 9)
    if not np.isfinite(matrix).all():
        raise FactorisationError("the deformation of an element is not finite")
    values, vectors = np.linalg.eigh(0.5 * (matrix + np.swapaxes(matrix, -1, -2)))
    positive = (vectors * np.maximum(values, 0.0)[..., None, :]) @ np.swapaxes(vectors, -1, -2)
    return np.asarray(positive.reshape(tangent.shape))


def von_mises(stress: Array) -> Array:
    """Von Mises stress in [Pa], shape (...), of stress tensors (..., 3, 3)."""
    deviator = stress - np.trace(stress, axis1=-2, axis2=-1)[..., None, None] / 3.0 * np.eye(3)
    return np.asarray(np.sqrt(1.5 * np.einsum("...ij,...ij->...", deviator, deviator)))


YOUNG_MODULUS = MaterialParameter("young_modulus", "Pa", "Young modulus", 0.0, inf)
POISSON_RATIO = MaterialParameter("poisson_ratio", "-", "Poisson ratio", -1.0, 0.5)
HOOKE = (YOUNG_MODULUS, POISSON_RATIO)
"""Parameters of a law that is Hooke's at small strain."""
STIFFNESS_FACTOR = MaterialParameter(
    "stiffness_factor", "-", "Factor on the stiffness, from a test of your own", 0.0, inf, default=1.0
)
"""Scales all constants of a curve whose shape is known better than its height."""


def lame(p: Array) -> tuple[Array, Array]:
    """Lame parameters (lambda, mu) in [Pa], shapes (...), of values (..., 2) of HOOKE."""
    young, poisson = p[..., 0], p[..., 1]
    return young * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson)), young / (2.0 * (1.0 + poisson))


def first_lame(shear: Array, poisson: Array) -> Array:
    """Lame's lambda in [Pa] of a shear modulus in [Pa] and a Poisson ratio, shapes (...)."""
    return np.asarray(2.0 * shear * poisson / (1.0 - 2.0 * poisson))
