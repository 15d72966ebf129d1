"""Drives of joints that move a frame: the coordinate is the joint's, the multiplier its torque or force.

Without stiffness, the joint is exactly at its command. With a spring of stiffness k, it deviates by the
torque t = k (q - s), which is a compliance of 1 / k. Its row is a unit vector. The step and statics therefore
add drives to their matrices (a prescribed unknown, or a stiffness on the diagonal) instead of their
constraint rows.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from softsim_core.base import Array
from softsim_core.physics.actuation.actuators import Actuator, PlainGroup
from softsim_core.physics.actuation.building import ActuatorKind, Placed, Surroundings
from softsim_core.physics.mechanics import Model, State


class JointDrive(Actuator):
    """Drive of a joint with a frame."""

    kind = "joint_drive"

    def __init__(self, model: Model, joint: int) -> None:
        described = model.joints[joint]
        place = len(model.rest) + 6 * len(model.frame_names) + joint
        compliance = 0.0 if described.stiffness is None else 1.0 / described.stiffness
        super().__init__(described.name, joint, np.array([place]), compliance=compliance)

    def value(self, model: Model, state: State) -> float:
        """Return the position of the joint in [rad] or [m]."""
        return float(state.joint_positions[self.joint])

    def row(self, model: Model, state: State) -> Array:
        """Return one in the joint's own place."""
        return np.array([[1.0, 0.0, 0.0]])


def drive_stiffness(model: Model) -> Array:
    """Return the stiffness in [N m/rad] or [N/m] of each joint's drive, 0 if prescribed, shape (j,)."""
    return np.array([joint.stiffness or 0.0 for joint in model.joints], dtype=float)


def _build(placed: Sequence[Placed], surroundings: Surroundings) -> PlainGroup:
    return PlainGroup([JointDrive(surroundings.model, each.joint) for each in placed])


JOINT_DRIVE = ActuatorKind("joint_drive", None, _build)
