"""Joint bases that are moved while the scene runs, as a hand slides a servo over its table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from softsim_core.arrays import Array
from softsim_core.errors import CommandError, listing
from softsim_core.mechanics.model import Joint

SPEED: Final = 0.05
"""Bases move this fast, in [m/s]: the body follows without a blow."""


class MovableBases:
    """Where the joint bases are in the model, and where they go.

    Args:
        joints: Joints of the model; their base positions are written in place.
    """

    def __init__(self, joints: Sequence[Joint]) -> None:
        self._joints = joints
        self._start = self.positions
        self._targets = self.positions
        self._arrived = True

    @property
    def positions(self) -> Array:
        """Origins of the bases in [m], shape (j, 3): parents at rest, without the start move's shift."""
        return np.array([joint.base_position for joint in self._joints]).reshape(-1, 3)

    def move(self, name: str, position: Sequence[float] | Array, base_shift: float) -> None:
        """Have the base of a joint, which the start move has shifted by `base_shift` [m], go to (3,) in [m].

        Raises:
            CommandError: no such joint, a cable's, or a position that is not three finite numbers; nothing is
            changed.
        """
        known = {joint.name: j for j, joint in enumerate(self._joints) if not joint.cable}
        if name not in known:
            raise CommandError(f"no joint {name!r} has a base; known: {listing(known)}")
        target = np.array(position, dtype=float)
        if target.shape != (3,) or not np.isfinite(target).all():
            raise CommandError(f"base of {name} refused: expected three finite numbers in metres")
        joint = self._joints[known[name]]
        self._targets[known[name]] = target + joint.base_position - joint.base_origin(base_shift)
        self._arrived = False

    def advance(self, dt: float) -> bool:
        """Move the bases for a time in [s]; returns whether one has moved."""
        if self._arrived:
            return False
        way = self._targets - self.positions
        length = np.linalg.norm(way, axis=1)
        moving = np.flatnonzero(length > 0.0).tolist()
        for j in moving:
            if length[j] <= SPEED * dt:
                self._joints[j].base_position[:] = self._targets[j]
            else:
                self._joints[j].base_position[:] += SPEED * dt / length[j] * way[j]
        self._arrived = not moving
        return not self._arrived

    def reset(self) -> None:
        """Back to where the scene has them."""
        self.restore(np.stack([self._start, self._start]))

    def state(self) -> Array:
        """Positions and targets, shape (2, j, 3)."""
        return np.stack([self.positions, self._targets])

    def restore(self, state: Array) -> None:
        """Go back to what `state` gave."""
        for joint, position in zip(self._joints, state[0], strict=True):
            joint.base_position[:] = position
        self._targets, self._arrived = state[1].copy(), False
