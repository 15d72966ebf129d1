"""One step in compiled code: assembly, then what the eliminated free nodes leave is solved, and all moves.

`advance` is the whole step around a factorisation; a step that eliminates in another way takes the parts.
"""

from __future__ import annotations

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.dynamics.numba_backend.actuator_rows import (
    add_rows,
    add_stiffness,
    hold_rows,
    report_rows,
)
from softsim_core.dynamics.numba_backend.cells import assemble_cells
from softsim_core.dynamics.numba_backend.compile import kernel
from softsim_core.dynamics.numba_backend.elements import CLAMPED, FROZEN, assemble_nodes
from softsim_core.dynamics.numba_backend.inversion import count_inverted
from softsim_core.dynamics.numba_backend.kinematics import (
    advance_reduced,
    jacobians,
    motion_subspace,
    place_regions,
    slides,
)
from softsim_core.dynamics.numba_backend.layout import (
    Acting,
    Cells,
    Kinematics,
    Motion,
    Nodes,
    Work,
)
from softsim_core.dynamics.numba_backend.reduced import eliminate_reduced, solve_reduced
from softsim_core.linalg.cholesky import factor, solve_backward
from softsim_core.linalg.layout import Tree
from softsim_core.linalg.simd import steady_seconds


@kernel
def assemble(
    motion: Motion, straining: Array, external: Array, h: float, lag: float, rayleigh_mass: float,
    kinematics: Kinematics, cells: Cells, nodes: Nodes, acting: Acting | None, tree: Tree, work: Work,
) -> None:  # fmt: skip
    """Forces, matrix and right-hand side of the step, into `work`, to what is there of paired cells."""
    x, v = motion.positions, motion.velocities
    motion_subspace(motion, kinematics, work)
    jacobians(motion, nodes, work)
    for n in range(len(x)):
        for i in range(3):
            work.forces[n, i] = external[n, i]
            work.ahead[n, i] = x[n, i] + lag * straining[n, i]
    assemble_cells(x, h * lag, CLAMPED, FROZEN, cells, nodes, work)
    assemble_nodes(v, h, rayleigh_mass, nodes, work)
    if acting is not None:
        add_rows(h, motion, acting.rows, acting.kinds, nodes, tree, work)
        add_stiffness(acting.stiffness, straining, motion.reduced_velocities, nodes, tree, work)


@kernel
def finish(
    motion: Motion, targets: Array, base_shift: float, lower: Array, upper: Array, h: float, lag: float,
    kinematics: Kinematics, tree: Tree, nodes: Nodes, acting: Acting | None, work: Work,
) -> float:  # fmt: skip
    """Solve reduced and interior, advance, report joint efforts; returns the largest speed, or NaN."""
    joints, velocities = len(motion.joint_positions), motion.reduced_velocities
    size, right = len(velocities), len(work.factor.schur)
    first = size - joints
    known = np.zeros(size, dtype=np.bool_)
    change = work.factor.solution[3 * len(nodes.free) :]
    for j in range(joints):
        b, stiffness = first + j, kinematics.stiffness[j]
        gap = targets[j] - motion.joint_positions[j]
        work.factor.schur[b, b] += kinematics.inertia[j] + h * lag * stiffness
        work.factor.schur[b, right] += h * stiffness * (gap - lag * velocities[b])
        if stiffness == 0.0:
            known[b] = True
            change[b] = gap / h - velocities[b]
    if acting is not None:
        for c in range(len(acting.rows.joint)):
            change[first + acting.rows.joint[c]] = 0.0  # moves no frame
    eliminate_reduced(work.factor.schur, known, change, work.scratch)
    if acting is not None:
        hold_rows(h, targets, lower, upper, change, size, acting.rows, work.scratch)
    solve_reduced(known, change, work.scratch)
    solve_backward(tree, work.factor)
    speed, finite = 0.0, True
    for f in range(len(nodes.free)):
        node, place = nodes.free[f], nodes.unknown[f]
        for i in range(3):
            motion.velocities[node, i] += work.factor.solution[place + i]
            motion.positions[node, i] += h * motion.velocities[node, i]
            speed = max(speed, abs(motion.velocities[node, i]))
            finite = finite and motion.velocities[node, i] == motion.velocities[node, i]
    for j in range(joints):
        b = first + j
        if known[b]:
            impulse = -work.factor.schur[b, right]
            for a in range(right):
                impulse += (work.factor.schur[a, b] if a < b else work.factor.schur[b, a]) * change[a]
            motion.joint_efforts[j] = impulse / h
    for b in range(size):
        velocities[b] += change[b]
        if slides(b, motion, kinematics):
            speed = max(speed, abs(velocities[b]))
        finite = finite and velocities[b] == velocities[b]
    advance_reduced(h, motion)
    motion.base_shift[0] = base_shift
    for j in range(joints):
        if known[first + j]:
            motion.joint_positions[j] = targets[j]  # exactly, without rounding
        else:
            motion.joint_efforts[j] = kinematics.stiffness[j] * (targets[j] - motion.joint_positions[j])
    place_regions(motion, kinematics, nodes, work)
    if acting is not None:
        report_rows(h, motion, acting.rows, acting.kinds, work)
    return speed if finite else np.nan


@kernel
def advance(
    motion: Motion, straining: Array, external: Array, targets: Array, base_shift: float, lower: Array,
    upper: Array, h: float, lag: float, rayleigh_mass: float, kinematics: Kinematics, cells: Cells,
    nodes: Nodes, acting: Acting | None, tree: Tree, work: Work, corners: IndexArray,
) -> tuple[float, int, float, float, float]:  # fmt: skip
    """One whole step.

    Returns:
        The largest speed, how many of the elements `corners` (m, 4) are inside out, and the seconds for
        assembly, factorisation and the rest.
    """
    started = steady_seconds()
    assemble(motion, straining, external, h, lag, rayleigh_mass, kinematics, cells, nodes, acting, tree, work)
    assembled = steady_seconds()
    factor(tree, work.factor)
    factored = steady_seconds()
    speed = finish(motion, targets, base_shift, lower, upper, h, lag, kinematics, tree, nodes, acting, work)
    inverted = count_inverted(motion.positions, corners)
    return speed, inverted, assembled - started, factored - assembled, steady_seconds() - factored
