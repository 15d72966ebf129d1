"""Compiled static tangent of the `polar` law, rotation of the elements included, into the factor's panels."""

from __future__ import annotations

from softsim_core.arrays import Array
from softsim_core.dynamics.numba_backend.cells import assemble_cells
from softsim_core.dynamics.numba_backend.compile import kernel
from softsim_core.dynamics.numba_backend.kinematics import jacobians, motion_subspace
from softsim_core.dynamics.numba_backend.layout import Cells, Kinematics, Motion, Nodes, Work
from softsim_core.linalg.compile import inlined


@kernel
def assemble_tangent(
    motion: Motion, external: Array, spring: Array, tangent: int, kinematics: Kinematics, cells: Cells,
    nodes: Nodes, work: Work,
) -> None:  # fmt: skip
    """The static tangent into panels and reduced, to what is there of paired cells.

    `external`: all loads but elastic ones (n, 3); `tangent`: elements.EXACT, or CLAMPED.
    """
    x = motion.positions
    motion_subspace(motion, kinematics, work)
    jacobians(motion, nodes, work)
    work.forces[:, :3] = external
    work.ahead[:] = x
    assemble_cells(x, 1.0, tangent, tangent, cells, nodes, work)
    for f in range(len(nodes.free)):
        for i in range(3):
            place = nodes.row[f] + i * nodes.stride[f] + nodes.column[f] + i
            work.factor.panels[place] += spring[nodes.free[f]]
    for z in range(len(nodes.region)):
        add_region_node(x, z, spring, nodes, work)
    first = len(motion.reduced_velocities) - len(kinematics.stiffness)
    for j in range(len(kinematics.stiffness)):
        work.factor.schur[first + j, first + j] += kinematics.stiffness[j]


@inlined
def add_region_node(x: Array, z: int, spring: Array, nodes: Nodes, work: Work) -> None:
    """Soft fixing of region node z, and the change of its load's moment as the region turns."""
    node = nodes.region[z]
    last = nodes.reduced[z, nodes.size[z] - 1]
    r0, r1, r2 = (
        x[node, 0] - work.origin[last, 0],
        x[node, 1] - work.origin[last, 1],
        x[node, 2] - work.origin[last, 2],
    )
    f0, f1, f2 = work.forces[node, 0], work.forces[node, 1], work.forces[node, 2]
    along = r0 * f0 + r1 * f1 + r2 * f2
    w = work.angular
    for q in range(nodes.size[z]):
        b = nodes.reduced[z, q]
        rb = w[b, 0] * r0 + w[b, 1] * r1 + w[b, 2] * r2
        fb = w[b, 0] * f0 + w[b, 1] * f1 + w[b, 2] * f2
        for p in range(q + 1):
            a = nodes.reduced[z, p]
            ra = w[a, 0] * r0 + w[a, 1] * r1 + w[a, 2] * r2
            fa = w[a, 0] * f0 + w[a, 1] * f1 + w[a, 2] * f2
            both = w[a, 0] * w[b, 0] + w[a, 1] * w[b, 1] + w[a, 2] * w[b, 2]
            work.factor.schur[a, b] += along * both - 0.5 * (ra * fb + fa * rb)
            for i in range(3):
                work.factor.schur[a, b] += spring[node] * work.jacobian[z, p, i] * work.jacobian[z, q, i]
