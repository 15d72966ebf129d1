"""Closed forms that the simulation is held to. SI units."""

from __future__ import annotations

import math

import numpy as np

from softsim_core.base import Array

BEAM_LOCKING = {
    (0.0, 1): 0.244,
    (0.0, 2): 0.550,
    (0.0, 3): 0.728,
    (0.0, 4): 0.824,
    (0.45, 1): 0.109,
    (0.45, 2): 0.299,
    (0.45, 3): 0.470,
    (0.45, 4): 0.598,
}
"""Tip deflection over the right one of a cantilever with L/H = 10 of linear tetrahedra: (Poisson, layers)."""


def fall_speed(gravity: float, dt: float, steps: int, damping: float = 0.0) -> float:
    """Speed after implicit Euler steps of free fall, (1 + h d) v+ = v + h g; exactly g t without damping."""
    if damping == 0.0:
        return gravity * dt * steps
    return gravity / damping * (1.0 - (1.0 + dt * damping) ** -steps)


def fall_height(gravity: float, dt: float, steps: int, damping: float = 0.0) -> float:
    """Height fallen in the same steps: the sum of h v, g h^2 n (n + 1) / 2 without damping."""
    return sum(dt * fall_speed(gravity, dt, step + 1, damping) for step in range(steps))


def tip_deflection(load: float, length: float, width: float, height: float, young_modulus: float) -> float:
    """Deflection of a cantilever under a tip load in the direction of its height: P L^3 / (3 E I)."""
    return load * length**3 / (3.0 * young_modulus * width * height**3 / 12.0)


def hooke_stress(displacement_gradient: Array, young_modulus: float, poisson_ratio: float) -> Array:
    """Stress (3, 3) of a small displacement gradient (3, 3) of an isotropic solid."""
    strain = 0.5 * (displacement_gradient + displacement_gradient.T)
    lam = young_modulus * poisson_ratio / ((1.0 + poisson_ratio) * (1.0 - 2.0 * poisson_ratio))
    mu = young_modulus / (2.0 * (1.0 + poisson_ratio))
    return lam * np.trace(strain) * np.eye(3) + 2.0 * mu * strain


def uniaxial_stretch(force: float, area: float, young_modulus: float) -> float:
    """Strain along a bar under a pull: F / (A E)."""
    return force / (area * young_modulus)


def weight_torque(mass: float, gravity: float, arm: float, angle: float) -> float:
    """Torque that holds a weight on an arm turned by `angle` from the horizontal."""
    return mass * gravity * arm * math.cos(angle)


def torsion_pendulum_angle(stiffness: float, torque: float) -> float:
    """Angle by which a torsion spring gives way to a torque."""
    return torque / stiffness


def incompressible_tension(law: str, stretch: float, constants: dict[str, float]) -> float:
    """Nominal stress in [Pa] along a free bar of rubber of constant volume, by the textbook's formulas."""
    pull = stretch - stretch**-2
    if law == "yeoh":
        t = stretch**2 + 2.0 / stretch - 3.0
        return 2.0 * pull * (constants["c1"] + 2.0 * constants["c2"] * t + 3.0 * constants["c3"] * t**2)
    if law == "mooney_rivlin":
        return 2.0 * pull * (constants["c10"] + constants["c01"] / stretch)
    terms = ((constants[f"m{k}"], constants[f"alpha{k}"]) for k in (1, 2))
    return sum(m / a * (stretch ** (a - 1.0) - stretch ** (-0.5 * a - 1.0)) for m, a in terms)
