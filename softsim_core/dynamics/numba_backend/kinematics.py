"""Compiled kernels for frames, joints and the nodes that follow them: the fast twin of mechanics.model."""

from __future__ import annotations

from math import cos, sin, sqrt

import numpy as np

from softsim_core.arrays import Array
from softsim_core.dynamics.numba_backend.compile import kernel
from softsim_core.dynamics.numba_backend.layout import Kinematics, Motion, Nodes, Work


@kernel
def exponential(w0: float, w1: float, w2: float, r: Array) -> None:
    """Rotation matrix r (3, 3) of the rotation vector (w0, w1, w2)."""
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
    """Whether the velocity of reduced coordinate b is one in [m/s], not one in [rad/s]."""
    first = 6 * len(motion.frame_positions)
    return b % 6 < 3 if b < first else not kinematics.revolute[b - first]


@kernel
def carried(j: int, c: int, motion: Motion, kinematics: Kinematics) -> float:
    """Coordinate c of how far the joints that carry joint j have moved its base."""
    shift, a = 0.0, kinematics.parent[j]
    while a >= 0:
        moved = motion.joint_positions[a] - kinematics.rest[a]
        for d in range(3):
            shift += moved * kinematics.base_rotation[a, c, d] * kinematics.axis[a, d]
        a = kinematics.parent[a]
    return shift


@kernel
def motion_subspace(motion: Motion, kinematics: Kinematics, work: Work) -> None:
    """Screw of each reduced coordinate, into work.angular, linear, origin."""
    base_rotation, axis, slide = kinematics.base_rotation, kinematics.axis, kinematics.slide
    angular, linear, origin = work.angular, work.linear, work.origin
    frames = len(motion.frame_positions)
    for f in range(frames):
        for i in range(6):
            k = 6 * f + i
            for c in range(3):
                angular[k, c] = 1.0 if i == c + 3 else 0.0
                linear[k, c] = 1.0 if i == c else 0.0
                origin[k, c] = motion.frame_positions[f, c]
    for j in range(len(axis)):
        k = 6 * frames + j
        for c in range(3):
            along = base_rotation[j, c, 0] * axis[j, 0] + base_rotation[j, c, 1] * axis[j, 1]
            along += base_rotation[j, c, 2] * axis[j, 2]
            away = base_rotation[j, c, 0] * slide[j, 0] + base_rotation[j, c, 1] * slide[j, 1]
            away += base_rotation[j, c, 2] * slide[j, 2]
            angular[k, c] = along if kinematics.revolute[j] else 0.0
            linear[k, c] = 0.0 if kinematics.revolute[j] else along
            origin[k, c] = motion.base_positions[j, c] + motion.base_shift[0] * away
            origin[k, c] += carried(j, c, motion, kinematics)


@kernel
def jacobians(motion: Motion, nodes: Nodes, work: Work) -> None:
    """Velocity of each region node a unit of each of its reduced coordinates, into work.jacobian."""
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
def joint_frame(j: int, motion: Motion, kinematics: Kinematics, origin: Array, rotation: Array) -> None:
    """Origin (3,) and rotation (3, 3) of the frame that joint j moves."""
    base_rotation, axis, q = kinematics.base_rotation, kinematics.axis, motion.joint_positions[j]
    turn, angle = np.empty((3, 3)), q if kinematics.revolute[j] else 0.0
    exponential(angle * axis[j, 0], angle * axis[j, 1], angle * axis[j, 2], turn)
    for c in range(3):
        origin[c] = motion.base_positions[j, c] + carried(j, c, motion, kinematics)
        for d in range(3):
            shift = motion.base_shift[0] * kinematics.slide[j, d] + (q - angle) * axis[j, d]
            origin[c] += base_rotation[j, c, d] * shift
            rotation[c, d] = (
                base_rotation[j, c, 0] * turn[0, d]
                + base_rotation[j, c, 1] * turn[1, d]
                + base_rotation[j, c, 2] * turn[2, d]
            )


@kernel
def region_frames(motion: Motion, kinematics: Kinematics, work: Work) -> None:
    """Origin and rotation of the frame that each region follows, into region_origins, region_rotations."""
    for region in range(len(kinematics.regions)):
        f, origin, rotation = (
            kinematics.regions[region, 0],
            work.region_origins[region],
            work.region_rotations[region],
        )
        if f < 0:
            joint_frame(kinematics.regions[region, 1], motion, kinematics, origin, rotation)
            continue
        for c in range(3):
            origin[c] = motion.frame_positions[f, c]
            for d in range(3):
                rotation[c, d] = motion.frame_rotations[f, c, d]


@kernel
def place_region_nodes(motion: Motion, nodes: Nodes, work: Work) -> None:
    """Positions of the region nodes from the frames of their regions."""
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
    """Velocities of the region nodes from those of frames and joints."""
    for z in range(len(nodes.region)):
        node = nodes.region[z]
        for c in range(3):
            total = 0.0
            for q in range(nodes.size[z]):
                total += work.jacobian[z, q, c] * motion.reduced_velocities[nodes.reduced[z, q]]
            motion.velocities[node, c] = total


@kernel
def advance_reduced(h: float, motion: Motion) -> None:
    """Move free frames and joints for one step at the reduced coordinates velocities."""
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
    """Move the nodes of all regions, and their velocities, to where frames and joints say."""
    region_frames(motion, kinematics, work)
    place_region_nodes(motion, nodes, work)
    motion_subspace(motion, kinematics, work)
    jacobians(motion, nodes, work)
    region_velocities(motion, nodes, work)
