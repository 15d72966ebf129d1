"""Plays an effector path: where it is now, running, paused, ended. No ROS, no clock of its own."""

from __future__ import annotations

from typing import Literal, TypeAlias

from softsim_core.errors import CommandError
from softsim_core.inverse.paths import EffectorPath
from softsim_core.mechanics.pose import Pose

PlayerState: TypeAlias = Literal["idle", "running", "paused", "ended"]


class PathPlayer:
    """One path at a time.

    Attributes:
        state: idle (nothing begun, or stopped), running, paused, or ended (the last pose was given).
        path: The path that was started last; None before the first.
        time: Path time in [s].
        rounds: Times a looped path began anew.
    """

    def __init__(self) -> None:
        self.state: PlayerState = "idle"
        self.path: EffectorPath | None = None
        self.time = 0.0
        self.rounds = 0

    @property
    def percent(self) -> float:
        """Part of the path that is done, 0..100."""
        if self.path is None or self.path.duration == 0.0:
            return 100.0 if self.state == "ended" else 0.0
        return 100.0 * min(self.time / self.path.duration, 1.0)

    def start(self, path: EffectorPath) -> None:
        """Play a path from its beginning, whatever was played before."""
        self.path, self.time, self.rounds, self.state = path, 0.0, 0, "running"

    def stop(self) -> None:
        """Give no poses any more."""
        self.state = "idle"

    def pause(self, paused: bool) -> None:
        """Stay where it is, or go on from there.

        Raises:
            CommandError: nothing is being played.
        """
        if self.state not in ("running", "paused"):
            raise CommandError(f"no path is running (it is {self.state}); call start first")
        self.state = "paused" if paused else "running"

    def advance(self, elapsed: float, *, loop: bool = False) -> Pose | None:
        """The pose after `elapsed` more seconds of path time; None while nothing runs.

        The last pose of a path that is not looped is given once; then the player has ended.
        """
        if self.state != "running" or self.path is None:
            return None
        self.time += elapsed
        duration = self.path.duration
        if self.path.is_over(self.time):
            if loop and duration > 0.0:
                self.rounds += int(self.time // duration)
                self.time %= duration
            else:
                self.time, self.state = duration, "ended"
        return self.path.sample(self.time)
