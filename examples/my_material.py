"""A material law of one's own: St. Venant-Kirchhoff in plain NumPy, in dynamics and statics.

The energy is Hooke's law on the Green strain E = (F^T F - I) / 2: P = F S, S = lambda tr(E) I + 2 mu E.
Run it: python examples/my_material.py
"""

from __future__ import annotations

import numpy as np

from softsim_core import (
    AttachmentDescription,
    BodyDescription,
    Box,
    MaterialDescription,
    SceneDescription,
    Simulation,
    SolverSettings,
    box_mesh,
)
from softsim_core.base import Array
from softsim_core.physics.fem.materials import Material, MaterialParameter, register_material

IDENTITY = np.eye(3)


class StVenantKirchhoff(Material):
    """Its parameters are the Lame parameters; crushed to 58 % of its length it collapses."""

    name = "st_venant_kirchhoff"
    parameters = (
        MaterialParameter("first_lame", "Pa", "lambda, resists a change of volume", 0.0),
        MaterialParameter("shear_modulus", "Pa", "mu, resists shear", 0.0),
    )

    def energy(self, deformation: Array, p: Array) -> Array:
        """Psi = lambda / 2 tr(E)^2 + mu E : E."""
        green = 0.5 * (deformation.swapaxes(-1, -2) @ deformation - IDENTITY)
        trace = np.trace(green, axis1=-2, axis2=-1)
        return np.asarray(0.5 * p[..., 0] * trace**2 + p[..., 1] * (green**2).sum(axis=(-2, -1)))

    def stress(self, deformation: Array, p: Array) -> Array:
        """P = F S."""
        return np.asarray(deformation @ self._second_piola(deformation, p))

    def tangent(self, deformation: Array, p: Array) -> Array:
        """dP_ij / dF_kl = d_ik S_lj + lambda F_ij F_kl + mu (F_il F_kj + (F F^T)_ik d_lj)."""
        lam, mu = p[..., 0, None, None, None, None], p[..., 1, None, None, None, None]
        left, second = deformation @ deformation.swapaxes(-1, -2), self._second_piola(deformation, p)
        result = lam * np.einsum("...ij,...kl->...ijkl", deformation, deformation)
        result = result + mu * np.einsum("...il,...kj->...ijkl", deformation, deformation)
        result = result + mu * np.einsum("...ik,lj->...ijkl", left, IDENTITY)
        return np.asarray(result + np.einsum("ik,...lj->...ijkl", IDENTITY, second))

    def _second_piola(self, deformation: Array, p: Array) -> Array:
        green = 0.5 * (deformation.swapaxes(-1, -2) @ deformation - IDENTITY)
        trace = np.trace(green, axis1=-2, axis2=-1)[..., None, None]
        return np.asarray(p[..., 0, None, None] * trace * IDENTITY + 2.0 * p[..., 1, None, None] * green)


def sagging_beam(backend: str = "auto") -> tuple[float, float]:
    """Sag in [mm] of a beam held at one end, after 2 s of dynamics and by statics."""
    register_material(StVenantKirchhoff())
    law = MaterialDescription(law="st_venant_kirchhoff", first_lame=5e4, shear_modulus=5e4)
    beam = BodyDescription(
        name="beam", mesh=box_mesh((0.1, 0.02, 0.02), (6, 2, 2)), material=law, total_mass=0.04
    )
    wall = Box(center=(0.0, 0.01, 0.01), size=(1e-4, 0.1, 0.1))
    held = AttachmentDescription(name="held", body="beam", to="world", box=wall)
    solver = SolverSettings(backend=backend, rayleigh_mass=10.0)  # type: ignore[arg-type]
    simulation = Simulation(SceneDescription(name="beam", bodies=(beam,), attachments=(held,), solver=solver))
    for _ in range(200):
        simulation.step()
    rest, static = simulation.model.rest[:, 2], simulation.equilibrium([]).state.positions[:, 2]
    return 1e3 * float((rest - simulation.positions[:, 2]).max()), 1e3 * float((rest - static).max())


if __name__ == "__main__":
    print("sag of the tip: {:.4f} mm in motion, {:.4f} mm in equilibrium".format(*sagging_beam()))
