"""A material law of one's own: St. Venant-Kirchhoff in one function, in dynamics and statics.

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
from softsim_core.physics.fem.materials import MaterialParameter, PointLaw, register_material


class StVenantKirchhoff(PointLaw):
    """Its parameters are the Lame parameters; crushed to 58 % of its length it collapses."""

    name = "st_venant_kirchhoff"
    parameters = (
        MaterialParameter("first_lame", "Pa", "lambda, resists a change of volume", 0.0),
        MaterialParameter("shear_modulus", "Pa", "mu, resists shear", 0.0),
    )

    def energy(self, deformation: Array, p: Array) -> Array:
        """Psi = lambda / 2 tr(E)^2 + mu E : E, at any number of points."""
        green = 0.5 * (deformation.swapaxes(-1, -2) @ deformation - np.eye(3))
        of_volume = 0.5 * p[..., 0] * np.trace(green, axis1=-2, axis2=-1) ** 2
        return np.asarray(of_volume + p[..., 1] * (green**2).sum(axis=(-2, -1)))

    @staticmethod
    def stress_and_tangent(f: Array, p: Array, stress: Array, tangent: Array) -> None:
        """P = F S and dP_ij / dF_kl at one point; Numba compiles it."""
        lam, mu = p[0], p[1]
        left, second = np.zeros((3, 3)), np.zeros((3, 3))
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    left[i, j] += f[i, k] * f[j, k]
                    second[i, j] += mu * f[k, i] * f[k, j]
        for i in range(3):
            second[i, i] += 0.5 * lam * (left[0, 0] + left[1, 1] + left[2, 2] - 3.0) - mu
        for i in range(3):
            for j in range(3):
                stress[i, j] = f[i, 0] * second[0, j] + f[i, 1] * second[1, j] + f[i, 2] * second[2, j]
                for k in range(3):
                    for n in range(3):
                        tangent[i, j, k, n] = lam * f[i, j] * f[k, n] + mu * f[i, n] * f[k, j]
                    tangent[i, j, k, j] += mu * left[i, k]
                for n in range(3):
                    tangent[i, j, i, n] += second[j, n]


def sagging_beam(backend: str = "auto") -> tuple[float, float]:
    """Sag in [mm] of a beam held at one end, after 2 s of dynamics and by statics."""
    register_material(StVenantKirchhoff())
    law = MaterialDescription(law="st_venant_kirchhoff", first_lame=5e4, shear_modulus=5e4)
    mesh = box_mesh((0.1, 0.02, 0.02), (6, 2, 2))
    beam = BodyDescription(name="beam", mesh=mesh, material=law, total_mass=0.04)
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
