"""Compiled kernels for frames, joints and the nodes that follow them: the fast twin of mechanics.model."""

from __future__ import annotations

from math import cos, sin, sqrt

import numpy as np

from softsim_core.dynamics.kernels import kernel


@kernel
def exponential(w0, w1, w2, r):  # type: ignore[no-untyped-def]
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
def screws(border, joints, angular, linear, origin):  # type: ignore[no-untyped-def]
    """Screw of each border unknown; `border` are the state's frame and joint arrays."""
    frame_positions, _, _, base_shift = border
    base_position, base_rotation, axis, slide, revolute = joints
    frames = len(frame_positions)
    for f in range(frames):
        for i in range(6):
            k = 6 * f + i
            for c in range(3):
                angular[k, c] = 1.0 if i == c + 3 else 0.0
                linear[k, c] = 1.0 if i == c else 0.0
                origin[k, c] = frame_positions[f, c]
    for j in range(len(base_position)):
        k = 6 * frames + j
        for c in range(3):
            along = base_rotation[j, c, 0] * axis[j, 0] + base_rotation[j, c, 1] * axis[j, 1]
            along += base_rotation[j, c, 2] * axis[j, 2]
            away = base_rotation[j, c, 0] * slide[j, 0] + base_rotation[j, c, 1] * slide[j, 1]
            away += base_rotation[j, c, 2] * slide[j, 2]
            angular[k, c] = along if revolute[j] else 0.0
            linear[k, c] = 0.0 if revolute[j] else along
            origin[k, c] = base_position[j, c] + base_shift[0] * away


@kernel
def jacobians(x, zone_nodes, zone_border, zone_size, angular, linear, origin, result):  # type: ignore[no-untyped-def]
    """Velocity of each zone node a unit of each of its border unknowns, into `result` (z, 6, 3)."""
    for z in range(len(zone_nodes)):
        node = zone_nodes[z]
        for q in range(zone_size[z]):
            k = zone_border[z, q]
            d0, d1, d2 = x[node, 0] - origin[k, 0], x[node, 1] - origin[k, 1], x[node, 2] - origin[k, 2]
            result[z, q, 0] = angular[k, 1] * d2 - angular[k, 2] * d1 + linear[k, 0]
            result[z, q, 1] = angular[k, 2] * d0 - angular[k, 0] * d2 + linear[k, 1]
            result[z, q, 2] = angular[k, 0] * d1 - angular[k, 1] * d0 + linear[k, 2]


@kernel
def zone_frames(border, joints, zones, origins, rotations):  # type: ignore[no-untyped-def]
    """Origin and rotation of the frame that each zone follows; `zones` are (frame, joint) index pairs."""
    frame_positions, frame_rotations, joint_positions, base_shift = border
    base_position, base_rotation, axis, slide, revolute = joints
    turn = np.empty((3, 3))
    for zone in range(len(zones)):
        f, j = zones[zone, 0], zones[zone, 1]
        if f >= 0:
            for c in range(3):
                origins[zone, c] = frame_positions[f, c]
                for d in range(3):
                    rotations[zone, c, d] = frame_rotations[f, c, d]
            continue
        q = joint_positions[j]
        if revolute[j]:
            exponential(q * axis[j, 0], q * axis[j, 1], q * axis[j, 2], turn)
        else:
            exponential(0.0, 0.0, 0.0, turn)
        for c in range(3):
            origins[zone, c] = base_position[j, c]
            for d in range(3):
                shift = base_shift[0] * slide[j, d] + (0.0 if revolute[j] else q * axis[j, d])
                origins[zone, c] += base_rotation[j, c, d] * shift
                rotations[zone, c, d] = (
                    base_rotation[j, c, 0] * turn[0, d]
                    + base_rotation[j, c, 1] * turn[1, d]
                    + base_rotation[j, c, 2] * turn[2, d]
                )


@kernel
def place_zone_nodes(x, zone_nodes, zone_of, local, origins, rotations):  # type: ignore[no-untyped-def]
    """Positions of the zone nodes from the frames of their zones."""
    for z in range(len(zone_nodes)):
        node, zone = zone_nodes[z], zone_of[z]
        for c in range(3):
            x[node, c] = origins[zone, c] + (
                rotations[zone, c, 0] * local[z, 0]
                + rotations[zone, c, 1] * local[z, 1]
                + rotations[zone, c, 2] * local[z, 2]
            )


@kernel
def zone_velocities(v, velocities, zone_nodes, zone_border, zone_size, jacobian):  # type: ignore[no-untyped-def]
    """Velocities of the zone nodes from those of frames and joints."""
    for z in range(len(zone_nodes)):
        node = zone_nodes[z]
        for c in range(3):
            total = 0.0
            for q in range(zone_size[z]):
                total += jacobian[z, q, c] * velocities[zone_border[z, q]]
            v[node, c] = total


@kernel
def advance_frames(h, border, velocities):  # type: ignore[no-untyped-def]
    """Move free frames and joints for one step at the border velocities."""
    frame_positions, frame_rotations, joint_positions, _ = border
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
    for j in range(len(joint_positions)):
        joint_positions[j] += h * velocities[6 * frames + j]
