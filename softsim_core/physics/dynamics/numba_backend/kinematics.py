"""Compiled kinematics of frames, joints and nodes, and the reduced coordinates of a step.

An actuator with row H is treated like a reduced coordinate: its column is H^T, its own diagonal is zero, and
its unknown is minus the impulse h t. Elimination then leaves minus the actuators' compliance, on which the
bounds are imposed.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import cos, sin, sqrt
from typing import NamedTuple

import numpy as np

from softsim_core.base import Array, BoolArray, IndexArray, unique_pairs
from softsim_core.physics.dynamics.numba_backend.layout import (
    Kinematics,
    Motion,
    Nodes,
    Work,
    kernel,
    node_pairs,
)
from softsim_core.physics.dynamics.numba_backend.stretches import nearest_rotations
from softsim_core.physics.fem import ElementGroup
from softsim_core.physics.linalg import LANES
from softsim_core.physics.mechanics import Model


class Surroundings(NamedTuple):
    """Free nodes and the nodes that share a cell with them.

    Attributes:
        node: Node index, in the order of unknowns, shape (f,).
        start: First neighbour of each node in `neighbour`, and the end, shape (f + 1,).
        neighbour: Node indices of the neighbours.
        rest: Vector from the node to each neighbour at rest over its squared length, in [1/m], shape (., 3).
    """

    node: IndexArray
    start: IndexArray
    neighbour: IndexArray
    rest: Array


def surroundings(model: Model, groups: Iterable[ElementGroup], position: IndexArray) -> Surroundings:
    """Return the surroundings of a model's free nodes.

    `position` (f,) is their place in the order of unknowns.
    """
    place = np.full(len(model.rest), -1, dtype=np.int64)
    place[model.free_nodes] = position
    pairs = np.concatenate([np.zeros((0, 2), np.int64), *(node_pairs(group.cells) for group in groups)])
    pairs = unique_pairs(pairs[(place[pairs[:, 0]] >= 0) & (pairs[:, 0] != pairs[:, 1])])
    pairs = pairs[np.argsort(place[pairs[:, 0]], kind="stable")]
    counts = np.bincount(place[pairs[:, 0]], minlength=len(position))
    away = model.rest[pairs[:, 1]] - model.rest[pairs[:, 0]]
    return Surroundings(
        model.free_nodes[np.argsort(position)],
        np.concatenate([[0], np.cumsum(counts)]),
        np.ascontiguousarray(pairs[:, 1]),
        away / np.maximum((away * away).sum(axis=1), np.finfo(float).tiny)[:, None],
    )


@kernel
def turn(x: Array, around: Surroundings, rotations: Array) -> None:
    """Compute the rotation (f, 3, 3) that best fits each node's neighbours from rest to x (n, 3)."""
    f, r = np.zeros((9, LANES)), np.empty((9, LANES))
    count = len(around.node)
    for first in range(0, count, LANES):
        f[:] = 0.0
        lanes = min(LANES, count - first)
        for lane in range(lanes):
            node = around.node[first + lane]
            for e in range(around.start[first + lane], around.start[first + lane + 1]):
                other = around.neighbour[e]
                for i in range(3):
                    along = x[other, i] - x[node, i]
                    for j in range(3):
                        f[3 * i + j, lane] += along * around.rest[e, j]
        nearest_rotations(f, r)
        for lane in range(lanes):
            for i in range(9):
                rotations[first + lane, i // 3, i % 3] = r[i, lane]


@kernel
def exponential(w0: float, w1: float, w2: float, r: Array) -> None:
    """Compute the rotation matrix r (3, 3) of the rotation vector (w0, w1, w2)."""
    angle = sqrt(w0 * w0 + w1 * w1 + w2 * w2)
    if angle < 1e-8:
        a, b = 1.0, 0.5
    else:
        a, b = sin(angle) / angle, (1.0 - cos(angle)) / (angle * angle)
    r[0, 0] = 1.0 - b * (w1 * w1 + w2 * w2)
    r[1, 1] = 1.0 - b * (w0 * w0 + w2 * w2)
    r[2, 2] = 1.0 - b * (w0 * w0 + w1 * w1)
    r[0, 1], r[1, 0] = b * w0 * w1 - a * w2, b * w0 * w1 + a * w2
    r[0, 2], r[2, 0] = b * w0 * w2 + a * w1, b * w0 * w2 - a * w1
    r[1, 2], r[2, 1] = b * w1 * w2 - a * w0, b * w1 * w2 + a * w0


@kernel
def slides(b: int, motion: Motion, kinematics: Kinematics) -> bool:
    """Return whether the velocity of reduced coordinate b is in [m/s] instead of [rad/s]."""
    first = 6 * len(motion.frame_positions)
    return b % 6 < 3 if b < first else not kinematics.revolute[b - first]


@kernel
def joint_frames(motion: Motion, kinematics: Kinematics, work: Work) -> None:
    """Compute the frames of all bases and those that the joints move into work.base_* and work.joint_*.

    Where a joint carries a base, the base moves with it, from its place at the joint's rest position.
    """
    base_rotation, axis, slide = kinematics.base_rotation, kinematics.axis, kinematics.slide
    turn, away = np.empty((3, 3)), np.empty(3)
    for j in range(len(axis)):
        origin, rotation, a = work.base_origins[j], work.base_rotations[j], kinematics.parent[j]
        for c in range(3):
            origin[c] = motion.base_positions[j, c]
            for d in range(3):
                origin[c] += base_rotation[j, c, d] * motion.base_shift[0] * slide[j, d]
                rotation[c, d] = base_rotation[j, c, d]
        if a >= 0:
            moved = 0.0 if kinematics.revolute[a] else kinematics.rest[a]
            for c in range(3):
                away[c] = origin[c] - motion.base_positions[a, c]
                for d in range(3):
                    along = motion.base_shift[0] * slide[a, d] + moved * axis[a, d]
                    away[c] -= base_rotation[a, c, d] * along
            for c in range(3):
                for d in range(3):
                    turn[c, d] = 0.0
                    for e in range(3):
                        turn[c, d] += work.joint_rotations[a, c, e] * kinematics.rest_rotation[a, d, e]
            for c in range(3):
                origin[c] = work.joint_origins[a, c]
                for d in range(3):
                    origin[c] += turn[c, d] * away[d]
                    rotation[c, d] = 0.0
                    for e in range(3):
                        rotation[c, d] += turn[c, e] * base_rotation[j, e, d]
        q = motion.joint_positions[j]
        angle = q if kinematics.revolute[j] else 0.0
        exponential(angle * axis[j, 0], angle * axis[j, 1], angle * axis[j, 2], turn)
        for c in range(3):
            work.joint_origins[j, c] = origin[c]
            for d in range(3):
                work.joint_origins[j, c] += rotation[c, d] * (q - angle) * axis[j, d]
                work.joint_rotations[j, c, d] = 0.0
                for e in range(3):
                    work.joint_rotations[j, c, d] += rotation[c, e] * turn[e, d]


@kernel
def motion_subspace(motion: Motion, kinematics: Kinematics, work: Work) -> None:
    """Compute the motion subspace of the reduced coordinates into work.angular, work.linear and work.origin.

    The frames of the joints are computed, too; see `joint_frames`.
    """
    axis = kinematics.axis
    angular, linear, origin = work.angular, work.linear, work.origin
    joint_frames(motion, kinematics, work)
    frames = len(motion.frame_positions)
    for f in range(frames):
        for i in range(6):
            k = 6 * f + i
            for c in range(3):
                angular[k, c] = 1.0 if i == c + 3 else 0.0
                linear[k, c] = 1.0 if i == c else 0.0
                origin[k, c] = motion.frame_positions[f, c]
    for j in range(len(axis)):
        k, rotation = 6 * frames + j, work.base_rotations[j]
        for c in range(3):
            along = rotation[c, 0] * axis[j, 0] + rotation[c, 1] * axis[j, 1] + rotation[c, 2] * axis[j, 2]
            angular[k, c] = along if kinematics.revolute[j] else 0.0
            linear[k, c] = 0.0 if kinematics.revolute[j] else along
            origin[k, c] = work.base_origins[j, c]


@kernel
def jacobians(motion: Motion, nodes: Nodes, work: Work) -> None:
    """Compute the velocity of each region node per unit of its reduced coordinates into work.jacobian."""
    x, angular, linear, origin, result = (
        motion.positions,
        work.angular,
        work.linear,
        work.origin,
        work.jacobian,
    )
    for z in range(len(nodes.region)):
        node = nodes.region[z]
        for q in range(nodes.size[z]):
            k = nodes.reduced[z, q]
            d0, d1, d2 = x[node, 0] - origin[k, 0], x[node, 1] - origin[k, 1], x[node, 2] - origin[k, 2]
            result[z, q, 0] = angular[k, 1] * d2 - angular[k, 2] * d1 + linear[k, 0]
            result[z, q, 1] = angular[k, 2] * d0 - angular[k, 0] * d2 + linear[k, 1]
            result[z, q, 2] = angular[k, 0] * d1 - angular[k, 1] * d0 + linear[k, 2]


@kernel
def region_frames(motion: Motion, kinematics: Kinematics, work: Work) -> None:
    """Compute the frame that each region follows into work.region_origins and work.region_rotations."""
    joint_frames(motion, kinematics, work)
    for region in range(len(kinematics.regions)):
        f, j = kinematics.regions[region, 0], kinematics.regions[region, 1]
        origins = motion.frame_positions if f >= 0 else work.joint_origins
        rotations = motion.frame_rotations if f >= 0 else work.joint_rotations
        followed = f if f >= 0 else j
        for c in range(3):
            work.region_origins[region, c] = origins[followed, c]
            for d in range(3):
                work.region_rotations[region, c, d] = rotations[followed, c, d]


@kernel
def place_region_nodes(motion: Motion, nodes: Nodes, work: Work) -> None:
    """Compute the positions of the region nodes from the frames of their regions."""
    x, local, origins, rotations = motion.positions, nodes.local, work.region_origins, work.region_rotations
    for z in range(len(nodes.region)):
        node, region = nodes.region[z], nodes.region_of[z]
        for c in range(3):
            x[node, c] = origins[region, c] + (
                rotations[region, c, 0] * local[z, 0]
                + rotations[region, c, 1] * local[z, 1]
                + rotations[region, c, 2] * local[z, 2]
            )


@kernel
def region_velocities(motion: Motion, nodes: Nodes, work: Work) -> None:
    """Compute the velocities of the region nodes from those of frames and joints."""
    for z in range(len(nodes.region)):
        node = nodes.region[z]
        for c in range(3):
            total = 0.0
            for q in range(nodes.size[z]):
                total += work.jacobian[z, q, c] * motion.reduced_velocities[nodes.reduced[z, q]]
            motion.velocities[node, c] = total


@kernel
def advance_reduced(h: float, motion: Motion) -> None:
    """Move free frames and joints for one step at the velocities of the reduced coordinates."""
    frame_positions, frame_rotations = motion.frame_positions, motion.frame_rotations
    velocities = motion.reduced_velocities
    turn, old = np.empty((3, 3)), np.empty((3, 3))
    frames = len(frame_positions)
    for f in range(frames):
        k = 6 * f
        for c in range(3):
            frame_positions[f, c] += h * velocities[k + c]
            for d in range(3):
                old[c, d] = frame_rotations[f, c, d]
        exponential(h * velocities[k + 3], h * velocities[k + 4], h * velocities[k + 5], turn)
        for c in range(3):
            for d in range(3):
                frame_rotations[f, c, d] = (
                    turn[c, 0] * old[0, d] + turn[c, 1] * old[1, d] + turn[c, 2] * old[2, d]
                )
    for j in range(len(motion.joint_positions)):
        motion.joint_positions[j] += h * velocities[6 * frames + j]


@kernel
def place_regions(motion: Motion, kinematics: Kinematics, nodes: Nodes, work: Work) -> None:
    """Update positions and velocities of the nodes of all regions from frames and joints."""
    region_frames(motion, kinematics, work)
    place_region_nodes(motion, nodes, work)
    motion_subspace(motion, kinematics, work)
    jacobians(motion, nodes, work)
    region_velocities(motion, nodes, work)


@kernel
def eliminate_reduced(schur: Array, prescribed: BoolArray, change: Array, matrix: Array) -> None:
    """Eliminate the solved frames and joints from the upper triangle of `schur` (last column: right side).

    Args:
        schur: Shape (b + c, b + c + 1), the actuators last.
        prescribed: Frames and joints with a given `change`, shape (b,).
        change: Velocity changes, shape (b + c,).
        matrix: Filled: rows of the factor, and the remainder for the actuators, shape of `schur`.
    """
    total, size = len(schur), len(prescribed)
    for i in range(total):
        if i < size and prescribed[i]:
            continue
        for j in range(i, total + 1):
            matrix[i, j] = schur[i, j]
        for j in range(size):
            if prescribed[j]:
                matrix[i, total] -= (schur[i, j] if i < j else schur[j, i]) * change[j]
    for i in range(size):
        if prescribed[i]:
            continue
        scale = 1.0 / sqrt(matrix[i, i])
        for j in range(i, total + 1):
            matrix[i, j] *= scale
        for k in range(i + 1, total):
            if k >= size or not prescribed[k]:
                for j in range(k, total + 1):
                    matrix[k, j] -= matrix[i, k] * matrix[i, j]


@kernel
def solve_reduced(prescribed: BoolArray, change: Array, matrix: Array) -> None:
    """Compute the unknown entries of `change`, after `eliminate_reduced`.

    Those of the actuators are given.
    """
    total, size = len(change), len(prescribed)
    for i in range(size - 1, -1, -1):
        if prescribed[i]:
            continue
        change[i] = matrix[i, total]
        for j in range(i + 1, total):
            if j >= size or not prescribed[j]:
                change[i] -= matrix[i, j] * change[j]
        change[i] /= matrix[i, i]
