"""The services that start, pause, step and reset a simulation."""

from __future__ import annotations

from collections.abc import Callable

from std_srvs.srv import SetBool, Trigger

from softsim_node.guarded_node import GuardedNode
from softsim_ros.simulator.answers import answering, attempt
from softsim_ros.simulator.physics_thread import PhysicsThread


class RunServices:
    """`~/reset`, `~/step`, `~/start`, `~/pause`.

    Args:
        node: The simulator's node.
        physics: What they act on.
        tell: Called once a pause has begun or ended, before that is answered.
    """

    def __init__(self, node: GuardedNode, physics: PhysicsThread, tell: Callable[[], None]) -> None:
        self._physics, self._tell = physics, tell
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
        self._tell()
        return response
