"""Compiled kernels of cables: the fast twin of actuation.cable.

A cable's row H stands as one more column of the border in the panels, so that factoring the step's matrix
brings H A^-1 H^T beside everything else; see fast.border.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from softsim_core.arrays import Array
from softsim_core.dynamics.fast.border import bounded_forces
from softsim_core.dynamics.fast.compile import kernel
from softsim_core.dynamics.fast.kinematics import joint_frame
from softsim_core.dynamics.fast.layout import Border, Lines, Motion, Nodes, Tree, Work

IN_BODY, IN_WORLD = -2, -1
"""What carries a cable's point where no joint does."""


@kernel
def trace(motion: Motion, border: Border, lines: Lines) -> None:
    """Points of all cables into lines.points, H on them into lines.pulls, their travels into lines.travel."""
    points, pulls = lines.points, lines.pulls
    origin, rotation = np.empty(3), np.empty((3, 3))
    for p in range(len(points)):
        carrier = lines.carrier[p]
        if carrier >= 0:
            joint_frame(carrier, motion, border, origin, rotation)
        for i in range(3):
            pulls[p, i] = 0.0
            if carrier == IN_BODY:
                points[p, i] = 0.0
                for k in range(4):
                    points[p, i] += lines.weights[p, k] * motion.positions[lines.nodes[p, k], i]
            elif carrier == IN_WORLD:
                points[p, i] = lines.local[p, i]
            else:
                points[p, i] = origin[i]
                for d in range(3):
                    points[p, i] += rotation[i, d] * lines.local[p, d]
    for c in range(len(lines.travel)):
        lines.travel[c] = lines.rest_length[c]
        for p in range(lines.first[c], lines.first[c + 1] - 1):
            square = 0.0
            for i in range(3):
                square += (points[p + 1, i] - points[p, i]) ** 2
            length = sqrt(square)
            lines.travel[c] -= length
            for i in range(3):
                unit = (points[p + 1, i] - points[p, i]) / max(length, 1e-12)
                pulls[p, i] += unit
                pulls[p + 1, i] -= unit


@kernel
def add_lines(
    h: float, motion: Motion, border: Border, lines: Lines, nodes: Nodes, tree: Tree, work: Work
) -> None:
    """Rows of all cables into their columns of panels and border; into lines.gap where they drift.

    That is their travel beyond the commanded one in [m] after h at the present velocities. The screws of the
    border have to be in `work`.
    """
    trace(motion, border, lines)
    for p in range(len(lines.points)):
        for k in range(4):
            for i in range(3):
                lines.coefficient[lines.entry[p] + k, i] = lines.weights[p, k] * lines.pulls[p, i]
    for m in range(len(lines.levers)):
        b, p = lines.lever_unknowns[m], lines.lever_points[m]
        total = 0.0
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            turned = work.angular[b, j] * (lines.points[p, k] - work.origin[b, k])
            turned -= work.angular[b, k] * (lines.points[p, j] - work.origin[b, j])
            total += lines.pulls[p, i] * (turned + work.linear[b, i])
        lines.coefficient[lines.levers[m], 0] = total
    size, count = len(motion.border_velocities), len(motion.positions)
    for c in range(len(lines.gap)):
        column, rate = size + c, 0.0
        for e in range(lines.start[c], lines.start[c + 1]):
            n = lines.place[e]
            if n >= count:
                work.schur[n - count, column] += lines.coefficient[e, 0]
                rate += lines.coefficient[e, 0] * motion.border_velocities[n - count]
                continue
            s, z = nodes.supernode[n], nodes.zone_number[n]
            for i in range(3):
                value = lines.coefficient[e, i]
                rate += value * motion.velocities[n, i]
                if s >= 0:
                    row = nodes.first_unknown[n] + i - tree.first_column[s]
                    at = tree.panel[s] + row * tree.width[s] + nodes.border_column[s, column]
                    work.panels[at] += value
                elif z >= 0:
                    for q in range(nodes.size[z]):
                        work.schur[nodes.border[z, q], column] += work.jacobian[z, q, i] * value
        lines.gap[c] = lines.travel[c] - motion.joint_positions[lines.joint[c]] + h * rate


@kernel
def hold_lines(
    h: float, lower: Array, upper: Array, change: Array, size: int, lines: Lines, matrix: Array
) -> None:
    """Tensions in [N] within their bounds (c,), and what they are to the border, into change[size:].

    `matrix` is what eliminate_border left; lines.gap is what the step leaves beyond the commanded travel.
    """
    count = len(lines.gap)
    total = size + count
    for c in range(count):
        lines.gap[c] -= h * matrix[size + c, total]
        for d in range(count):
            lines.compliance[c, d] = -h * h * matrix[size + min(c, d), size + max(c, d)]
    bounded_forces(lines.compliance, lines.gap, lower, upper, lines.tension)
    for c in range(count):
        change[size + c] = -h * lines.tension[c]
        for d in range(count):
            lines.gap[c] += lines.compliance[c, d] * lines.tension[d]


@kernel
def report_lines(motion: Motion, border: Border, lines: Lines) -> None:
    """Tensions as joint efforts, and travels as the positions of joints that are commanded by force."""
    traced = False
    for c in range(len(lines.tension)):
        j = lines.joint[c]
        motion.joint_efforts[j] = lines.tension[c]
        if lines.by_force[c]:
            if not traced:
                trace(motion, border, lines)
                traced = True
            motion.joint_positions[j] = lines.travel[c]
