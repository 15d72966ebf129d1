"""The copies of a batch that one process steps, one after the other in the same room to work in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from softsim_core.arrays import Array
from softsim_core.dynamics import Backend
from softsim_core.errors import BatchError, SoftSimError, SolverDivergedError
from softsim_core.scene.robot import RobotDescription
from softsim_core.simulation import Simulation


class Share:
    """See the module.

    Args:
        robot: What each is a copy of.
        backend: See Simulation.
        leader: The first copy, where it is built already.
    """

    def __init__(
        self, robot: RobotDescription, backend: Backend | None, leader: Simulation | None = None
    ) -> None:
        self._robot, self._backend = robot, backend
        self._leader = Simulation(robot, backend) if leader is None else leader
        self._copies: list[Simulation] = []
        self._states: list[Array] = []
        self._failed: set[int] = set()

    def fill(self, states: Array) -> None:
        """Make a copy for each row of `states` (k, s), which its state lives in from now on."""
        for row in states:
            copy = Simulation(self._robot, self._backend, self._leader) if self._copies else self._leader
            copy.keep_state_in(row)
            self._copies.append(copy)
            self._states.append(row)

    def command(self, chosen: Sequence[int], values: Array) -> list[Array]:
        """See Simulation.command, of each chosen copy its row of `values`; what each accepted."""
        return [self._copies[k].command(row) for k, row in zip(chosen, values, strict=True)]

    def step(self, chosen: Sequence[int], steps: int) -> dict[int, str]:
        """Advance each chosen copy by so many steps; of those that diverged, why.

        They stay at their last good state, and are passed over until they are reset.
        """
        failed = {}
        for k in chosen:
            if k in self._failed:
                continue
            step = self._copies[k].step
            try:
                for _ in range(steps):
                    step()
            except SolverDivergedError as error:
                failed[k] = str(error)
                self._failed.add(k)
        return failed

    def reset(self, chosen: Sequence[int]) -> None:
        """See Simulation.reset."""
        for k in chosen:
            self._copies[k].reset()
        self._failed.difference_update(chosen)

    def restore(self, chosen: Sequence[int], snapshot: bytes) -> None:
        """See Simulation.restore."""
        for k in chosen:
            self._copies[k].restore(snapshot)
        self._failed.difference_update(chosen)

    def rebuild(self, k: int, robot: RobotDescription) -> None:
        """Make a copy one of a scene that differs in numbers; it begins anew.

        Raises:
            BatchError: it differs in more; the copy stays what it was.
            SceneError, MeshError, MaterialError: the scene cannot be built.
        """
        copy = Simulation(robot, self._backend, self._leader)
        if copy.state_parts != self._leader.state_parts or copy.joint_names != self._leader.joint_names:
            raise BatchError(
                f"scene {robot.name} has other nodes, frames, joints or bodies than the batch's; "
                "change numbers only, or make a batch of its own"
            )
        if k:
            copy.keep_state_in(self._states[k])
            self._copies[k] = copy
        else:  # the others go on sharing what the first one has planned
            copy.keep_state_in(self._states[0])
            self._copies[0] = copy
        self._failed.discard(k)

    def call(self, k: int, name: str, arguments: Sequence[Any], named: Mapping[str, Any]) -> Any:
        """What a method of a copy gives, or one of its attributes."""
        found = getattr(self._copies[k], name)
        return found(*arguments, **named) if callable(found) else found


def failure(error: Exception) -> Exception:
    """An error as it may be sent to another process: one of the suite's own, or a sentence."""
    if isinstance(error, SoftSimError) and error.args and len(error.args) == 1:
        own = BatchError(str(error))
        own.__cause__ = None
        return own
    return BatchError(f"{type(error).__name__}: {error}")
