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
    x, first = motion.positions, 6 * len(motion.frame_positions)
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
        add_region_node(x, z, spring, first, nodes, work)
    for j in range(len(kinematics.stiffness)):
        work.factor.schur[first + j, first + j] += kinematics.stiffness[j]


@inlined
def add_region_node(x: Array, z: int, spring: Array, joints: int, nodes: Nodes, work: Work) -> None:
    """Soft fixing of region node z, and the change of its load's work as frames and joints turn it.

    `joints`: the first reduced coordinate of joints. Of two joints, the outer one turns how the inner one
    moves the node; of the six of a frame, which turn at once, half of both orders counts.
    """
    node = nodes.region[z]
    for q in range(nodes.size[z]):
        b = nodes.reduced[z, q]
        for p in range(q + 1):
            a = nodes.reduced[z, p]
            total = turned_work(node, z, a, q, work)
            if b < joints:
                slides = work.angular[a, 0] == 0.0 and work.angular[a, 1] == 0.0 and work.angular[a, 2] == 0.0
                total = 0.0 if slides else 0.5 * (total + turned_work(node, z, b, p, work))
            work.factor.schur[a, b] -= total
            for i in range(3):
                work.factor.schur[a, b] += spring[node] * work.jacobian[z, p, i] * work.jacobian[z, q, i]


@inlined
def turned_work(node: int, z: int, a: int, q: int, work: Work) -> float:
    """F . (w x u) of region node z: its load, the turning of coordinate a, its motion by its q-th one."""
    f, w, u = work.forces, work.angular, work.jacobian
    total = f[node, 0] * (w[a, 1] * u[z, q, 2] - w[a, 2] * u[z, q, 1])
    total += f[node, 1] * (w[a, 2] * u[z, q, 0] - w[a, 0] * u[z, q, 2])
    return total + f[node, 2] * (w[a, 0] * u[z, q, 1] - w[a, 1] * u[z, q, 0])  # type: ignore[no-any-return]
