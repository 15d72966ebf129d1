"""What actuators press on, face by face: blocks of their stiffness, and the forces that it lags behind."""

from __future__ import annotations

from typing import NamedTuple

from softsim_core.arrays import Array, IndexArray
from softsim_core.dynamics.numba_backend.compile import kernel


class PressedFaces(NamedTuple):
    """Faces of one surface, m of them with a nodes each.

    Attributes:
        faces: Their nodes, shape (m, a).
        order: How they are eliminated, shape (m,).
        inside: And then the nodes of each, shape (m, a).
        blocks: Room for the blocks of all pairs of nodes in that order, shape (m, a (a + 1) / 2, 3, 4); their
            diagonals and the fourth number of a row stay zero.
    """

    faces: IndexArray
    order: IndexArray
    inside: IndexArray
    blocks: Array


@kernel
def press_faces(
    stiffness: Array, surface: PressedFaces, velocities: Array, lag: float, scale: float, forces: Array
) -> None:
    """Fill the blocks of a surface, and add -lag K v to the forces (n, 3) in [N].

    Args:
        stiffness: v of the blocks, see Actuator.surface_stiffness, shape (m, 3, a, a).
        surface: The faces.
        velocities: v in [m/s], shape (n, 3).
        lag: In [s].
        scale: What the blocks are multiplied by.
        forces: Added to.
    """
    faces, order, inside, blocks = surface.faces, surface.order, surface.inside, surface.blocks
    count, nodes = faces.shape
    for e in range(count):
        face, pair = order[e], 0
        for first in range(nodes):
            for second in range(first, nodes):
                a, b = inside[e, first], inside[e, second]
                for i in range(3):
                    j, k = (i + 1) % 3, (i + 2) % 3
                    part = scale * stiffness[face, i, a, b]
                    blocks[e, pair, j, k], blocks[e, pair, k, j] = -part, part
                pair += 1
        for a in range(nodes):
            for b in range(nodes):
                n = faces[face, b]
                for i in range(3):
                    j, k = (i + 1) % 3, (i + 2) % 3
                    turned = stiffness[face, j, a, b] * velocities[n, k]
                    turned -= stiffness[face, k, a, b] * velocities[n, j]
                    forces[faces[face, a], i] -= lag * turned
