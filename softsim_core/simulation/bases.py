"""Joint bases that are moved while the scene runs, as a hand slides a servo over its table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from softsim_core.arrays import Array
from softsim_core.errors import CommandError
from softsim_core.mechanics.model import Model
from softsim_core.mechanics.state import State
from softsim_core.wrong_names import known_names

SPEED: Final = 0.05
"""Bases move this fast, in [m/s]: the body follows without a blow."""


class MovableBases:
    """Where the joint bases go; where they are is in State.base_positions.

    Attributes:
        targets: Where each base goes in [m], shape (j, 3): parents at rest, without the start move's shift.
    """

    def __init__(self, model: Model) -> None:
        self._model = model
        self._start = model.rest_state().base_positions.copy()
        self.targets = self._start.copy()
        self._arrived = True

    def move(self, name: str, position: Sequence[float] | Array, base_shift: float) -> None:
        """Have the base of a joint, which the start move has shifted by `base_shift` [m], go to (3,) in [m].

        Raises:
            CommandError: no such joint, one without a frame, or a position that is not three finite numbers;
            nothing is changed.
        """
        joints = self._model.joints
        known = {joint.name: j for j, joint in enumerate(joints) if joint.moves_frame}
        if name not in known:
            raise CommandError(f"no joint {name!r} has a base; {known_names(name, known)}")
        target = np.array(position, dtype=float)
        if target.shape != (3,) or not np.isfinite(target).all():
            raise CommandError(f"base of {name} refused: expected three finite numbers in metres")
        j = known[name]
        base = self._start[j]
        self.targets[j] = target + base - joints[j].base_origin(base, base_shift)
        self._arrived = False

    def advance(self, state: State, dt: float) -> bool:
        """Move the bases of a state, and what they carry, for a time in [s]; whether one has moved."""
        if self._arrived:
            return False
        way = self.targets - state.base_positions
        length = np.linalg.norm(way, axis=1)
        moving = np.flatnonzero(length > 0.0).tolist()
        for j in moving:
            if length[j] <= SPEED * dt:
                state.base_positions[j] = self.targets[j]
            else:
                state.base_positions[j] += SPEED * dt / length[j] * way[j]
        self._arrived = not moving
        if moving:
            self._model.place_regions(state)
        return bool(moving)

    def reset(self) -> None:
        """Nothing is to be moved any more: the bases are back where the scene has them."""
        self.restore(self._start)

    def restore(self, targets: Array) -> None:
        """Go on to other targets (j, 3)."""
        self.targets, self._arrived = targets.copy(), False
