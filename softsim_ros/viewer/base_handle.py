"""The handle with which the mouse moves the base of one joint."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from softsim_core.arrays import Array
from softsim_ros.viewer.panel import HOLD_S, Inbox


class BaseHandle:
    """Three arrows at a joint's base, while the joint is chosen.

    Args:
        scene: viser's scene.
        inbox: Where the mouse's events go.
        on_move: Called with the joint and where its base is to go, (3,) in [mm].
    """

    def __init__(self, scene: Any, inbox: Inbox, on_move: Callable[[str, Array], None]) -> None:
        self._scene, self._inbox, self._on_move = scene, inbox, on_move
        self._arrows: Any = None
        self._dragged, self._moved_at = False, -np.inf
        self._shown: Array = np.zeros(3)
        self.joint: str | None = None

    def choose(self, joint: str | None) -> None:
        """Show the handle of another joint, or none; it comes with the joint's next position."""
        self.joint, self._dragged, self._moved_at = joint, False, -np.inf
        if self._arrows is not None:
            self._arrows.remove()
            self._arrows = None

    def follow(self, position: Array) -> None:
        """Place it where the base is, (3,) in [mm]; a handle that is in the hand stays there."""
        if self._arrows is None:
            self._arrows = self._make(position)
        if not self._dragged and time.monotonic() - self._moved_at > HOLD_S:
            self._arrows.position = self._shown = position

    def _make(self, position: Array) -> Any:
        arrows = self._scene.add_transform_controls(
            "/base_handle", scale=30.0, disable_rotations=True, depth_test=False, position=position
        )

        async def moved(event: Any) -> None:
            position, ends = np.array(event.target.position), event.phase == "end"
            self._inbox.put(lambda: self._drag(position, ends))

        arrows.on_update(moved)
        return arrows

    def _drag(self, position: Array, ends: bool) -> None:
        self._dragged, self._moved_at = not ends, time.monotonic()
        moved, self._shown = not np.allclose(position, self._shown, atol=1e-6), position
        if self.joint is not None and moved:  # not only touched
            self._on_move(self.joint, position)
