"""A material law of one's own: compressible neo-Hookean rubber in one function, in dynamics and statics.

With J = det F, W = mu / 2 (F : F - 3) - mu ln J + lambda / 2 (ln J)^2, so P = mu F + (lambda ln J - mu) F^-T.
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


class NeoHookean(PointLaw):
    """Its parameters are the Lame parameters; it has no energy where a cell is flat or inside out."""

    name = "neo_hookean"
    parameters = (
        MaterialParameter("first_lame", "Pa", "lambda, resists a change of volume", 0.0),
        MaterialParameter("shear_modulus", "Pa", "mu, resists shear", 0.0),
    )

    def energy(self, deformation: Array, p: Array) -> Array:
        """Return W at any number of points."""
        log, square = np.log(np.linalg.det(deformation)), (deformation**2).sum(axis=(-2, -1))
        return np.asarray(p[..., 1] * (0.5 * (square - 3.0) - log) + 0.5 * p[..., 0] * log**2)

    @staticmethod
    def stress_and_tangent(f: Array, p: Array, stress: Array, tangent: Array) -> None:
        """Set P and dP_ij / dF_kl at one point; Numba compiles it."""
        cofactor = np.zeros((3, 3))
        for i in range(3):
            a, b = (i + 1) % 3, (i + 2) % 3
            for j in range(3):
                c, d = (j + 1) % 3, (j + 2) % 3
                cofactor[i, j] = f[a, c] * f[b, d] - f[a, d] * f[b, c]
        volume = f[0, 0] * cofactor[0, 0] + f[0, 1] * cofactor[0, 1] + f[0, 2] * cofactor[0, 2]
        inverse, pull = cofactor / volume, p[0] * np.log(volume) - p[1]  # F^-T
        for i in range(3):
            for j in range(3):
                stress[i, j] = p[1] * f[i, j] + pull * inverse[i, j]
                tangent[i, j, i, j] = p[1]
                for k in range(3):
                    for n in range(3):
                        tangent[i, j, k, n] += p[0] * inverse[i, j] * inverse[k, n]
                        tangent[i, j, k, n] -= pull * inverse[i, n] * inverse[k, j]


def sagging_beam(backend: str = "auto") -> tuple[float, float]:
    """Sag in [mm] of a beam held at one end, after 2 s of dynamics and by statics."""
    register_material(NeoHookean())
    law = MaterialDescription(law="neo_hookean", first_lame=5e4, shear_modulus=5e4)
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
