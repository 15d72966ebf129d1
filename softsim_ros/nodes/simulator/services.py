"""Services that run, pause, step and reset a simulation, and save and restore its state."""

from __future__ import annotations

from collections.abc import Callable

from std_srvs.srv import SetBool, Trigger

from softsim_core.base import SoftSimError
from softsim_node import GuardedNode
from softsim_ros.nodes.simulator.physics_thread import PhysicsThread
from softsim_ros.nodes.simulator.snapshot_folder import SnapshotFolder


def attempt(action: Callable[[], str]) -> tuple[bool, str]:
    """Run an action; return its success and its message for the response of a service."""
    try:
        return True, action()
    except SoftSimError as error:
        return False, str(error)


def answering(
    action: Callable[[], str],
) -> Callable[[Trigger.Request, Trigger.Response], Trigger.Response]:
    """Return a service callback that runs `action` and responds with its message."""

    def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = attempt(action)
        return response

    return answer


class RunServices:
    """`~/reset`, `~/step`, `~/start`, `~/pause`.

    Args:
        node: The simulator's node.
        physics: Thread that the services act on.
        on_pause_change: Called once a pause has begun or ended, before the response is sent.
    """

    def __init__(
        self, node: GuardedNode, physics: PhysicsThread, on_pause_change: Callable[[], None]
    ) -> None:
        self._physics, self._on_pause_change = physics, on_pause_change
        for name, action in (("reset", self._reset), ("step", self._step), ("start", self._start)):
            node.create_service(Trigger, f"~/{name}", answering(action))
        node.create_service(SetBool, "~/pause", self._on_pause)

    def _reset(self) -> str:
        self._physics.reset()
        paused = self._physics.status.paused
        return "back at the start of the scene" + ("; still paused" if paused else "")

    def _step(self) -> str:
        self._physics.step_once()
        return f"step {self._physics.status.steps} done"

    def _start(self) -> str:
        self._physics.play_start()
        return "start animation begun"

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        def pause() -> str:
            self._physics.pause(request.data)
            return "paused" if request.data else "running"

        response.success, response.message = attempt(pause)
        self._on_pause_change()
        return response


class SnapshotServices:
    """`~/save`, `~/load`.

    Args:
        node: The simulator's node.
        physics: Thread that owns the state.
        snapshots: Folder of the snapshots.
        name: Returns the name of the snapshot to save or load.
        loaded: Called after a snapshot was loaded.
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
