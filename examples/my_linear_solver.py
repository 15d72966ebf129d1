"""A linear solver of one's own in a scene's Python file: LAPACK's dense Cholesky factorisation.

Slow on large meshes, it shows what a solver has to do. Run it: python examples/my_linear_solver.py
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

import softsim_core as soft
from softsim_core.base import Array
from softsim_core.physics.linalg import Pattern, Rows, register_linear_solver, spread_of


class DenseCholesky:
    """The solver and its plan in one: for a dense matrix there is nothing to plan."""

    name = "dense_cholesky"
    _pattern: Pattern

    def plan(self, pattern: Pattern) -> DenseCholesky:
        """Keep the pattern: it says where the values go."""
        planned = DenseCholesky()
        planned._pattern = pattern
        return planned

    def factor(self, values: Array) -> DenseFactors:
        """Factor the matrix with these values."""
        return DenseFactors(self._pattern.matrix(values).toarray())


class DenseFactors:
    """What answers for one matrix."""

    def __init__(self, matrix: Array) -> None:
        try:
            self._factors, self.positive = cho_factor(matrix), True
        except np.linalg.LinAlgError:  # not positive: the plain inverse answers
            self.positive = False
            try:
                self._inverse = np.linalg.inv(matrix)
            except np.linalg.LinAlgError as error:
                raise soft.FactorisationError("the matrix is singular") from error

    def solve(self, right: Array) -> Array:
        """A^-1 B."""
        return np.asarray(cho_solve(self._factors, right) if self.positive else self._inverse @ right)

    def schur(self, rows: Rows) -> Array:
        """H A^-1 H^T."""
        spread = spread_of(rows)
        return np.asarray(spread.T @ self.solve(spread))


def create_scene(scene: soft.Scene) -> None:
    """A beam that sags from a wall."""
    register_linear_solver(DenseCholesky())
    scene.solver = replace(scene.solver, linear_solver="dense_cholesky")
    silicone = soft.MaterialDescription(young_modulus=2e5, poisson_ratio=0.4)
    mesh = soft.box_mesh((0.1, 0.02, 0.02), (6, 2, 2))
    wall = soft.Box(center=(0.0, 0.01, 0.01), size=(1e-4, 0.1, 0.1))
    scene.add(soft.BodyDescription(name="beam", mesh=mesh, material=silicone, total_mass=0.04))
    scene.add(soft.AttachmentDescription(name="held", body="beam", to="world", box=wall))


if __name__ == "__main__":
    simulation = soft.Simulation(soft.load_scene(__file__))
    sag = simulation.model.rest - simulation.equilibrium([]).state.positions
    sys.stdout.write(f"the beam sags by {1e3 * sag[:, 2].max():.4f} mm\n")
