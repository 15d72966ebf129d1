"""Corotational law of the reference simulator: an element turns with the frame of its first edges.

The frame results from the Gram-Schmidt process on the first two columns of F. F is taken in the axes of each
cell: its first edge and the plane of its first three nodes. The forces therefore depend on the order of the
nodes and have no potential. Their exact tangent is not symmetric, so a step freezes the rotations in it.

Source: Nesme, Payan, Faure 2005.
"""

from __future__ import annotations

import numpy as np

from softsim_core.base import Array
from softsim_core.physics.fem.materials.corotational import RotatedHooke, hooke_stress


class CorotationalQr(RotatedHooke):
    """Corotational law with R from the first two columns of F, by the Gram-Schmidt process."""

    name = "corotational_qr"
    has_potential = False
    in_cell_axes = True

    def rotations(self, deformation: Array) -> Array:
        """Return the Gram-Schmidt frame of each deformation gradient, shape (..., 3, 3)."""
        first = _unit(deformation[..., 0])
        third = _unit(np.cross(first, deformation[..., 1]))
        return np.stack([first, np.cross(third, first), third], axis=-1)

    def tangent(self, deformation: Array, p: Array) -> Array:
        """Return the exact tangent in [Pa], shape (..., 3, 3, 3, 3); it is not symmetric.

        A variation dF turns the frame by dR = R [w]x: with D = R^T dF and the upper triangle T = R^T F,
        w = ((D_21 - D_20 T_01 / T_00) / T_11, -D_20 / T_00, D_10 / T_00).
        """
        rotation = self.rotations(deformation)
        rt = np.swapaxes(rotation, -1, -2)
        triangle = rt @ deformation
        shape = np.broadcast_shapes(deformation.shape[:-2], p.shape[:-1])
        moves = np.zeros((*deformation.shape[:-2], 3, 3, 3, 3))  # D for dF = e_k e_l^T in [..., k, l, :, :]
        for column in range(3):
            moves[..., column, :, column] = rotation
        length, lean, height = triangle[..., 0, 0], triangle[..., 0, 1], triangle[..., 1, 1]
        length, lean, height = (each[..., None, None] for each in (length, lean, height))
        turn = np.zeros_like(moves)  # [w]x
        x = (moves[..., 2, 1] - moves[..., 2, 0] * lean / length) / height
        y, z = -moves[..., 2, 0] / length, moves[..., 1, 0] / length
        turn[..., 2, 1], turn[..., 0, 2], turn[..., 1, 0] = x, y, z
        turn = turn - np.swapaxes(turn, -1, -2)
        triangle = triangle[..., None, None, :, :]
        moved = moves - turn @ triangle
        wide = p[..., None, None, :]
        strain = 0.5 * (triangle + np.swapaxes(triangle, -1, -2)) - np.eye(3)
        change = turn @ hooke_stress(strain, wide)
        change = change + hooke_stress(0.5 * (moved + np.swapaxes(moved, -1, -2)), wide)
        result = np.einsum("...ai,...klij->...ajkl", rotation, change)
        return np.asarray(np.broadcast_to(result, (*shape, 3, 3, 3, 3)))

    def positive_tangent(self, deformation: Array, p: Array) -> Array:
        """Return the tangent with rotations frozen in [Pa], shape (..., 3, 3, 3, 3)."""
        return self.distant_tangent(deformation, p)


def _unit(vectors: Array) -> Array:
    """Return vectors (..., 3) scaled to length one."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))
