"""The services that save a simulation's state, and go back to it."""

from __future__ import annotations

from collections.abc import Callable

from std_srvs.srv import Trigger

from softsim_node.guarded_node import GuardedNode
from softsim_ros.simulator.answers import answering
from softsim_ros.simulator.physics_thread import PhysicsThread
from softsim_ros.simulator.snapshot_folder import SnapshotFolder


class SnapshotServices:
    """`~/save`, `~/load`.

    Args:
        node: The simulator's node.
        physics: Whose state.
        snapshots: Where snapshots are.
        name: Asked for the name of the one that is meant.
        loaded: Called once the state is another one.
    """

    def __init__(
        self,
        node: GuardedNode,
        physics: PhysicsThread,
        snapshots: SnapshotFolder,
        name: Callable[[], str],
        loaded: Callable[[], None],
    ) -> None:
        self._physics, self._snapshots, self._name, self._loaded = physics, snapshots, name, loaded
        for service, action in (("save", self._save), ("load", self._load)):
            node.create_service(Trigger, f"~/{service}", answering(action))

    def _save(self) -> str:
        data = self._physics.call(lambda simulation: simulation.snapshot(), shows=False)
        return f"saved to {self._snapshots.write(self._name(), data)}"

    def _load(self) -> str:
        name = self._name()
        self._physics.restore(self._snapshots.read(name))
        self._loaded()
        return f"loaded from {self._snapshots.file(name)}"
