"""The servo bridge as the teleop sees it: its lifecycle state, and the key that starts and stops sending."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from lifecycle_msgs.msg import State, Transition, TransitionEvent
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.node import Node

from softsim_ros.teleop.services import AsyncService
from softsim_ros.teleop.state import BridgeState

POLL_INTERVAL_S: Final = 1.0
STATE_WITHIN_S: Final = 2.5
"""Silence in [s] after which the bridge counts as gone: discovery forgets a killed process much later."""

STATES: Final[dict[int, BridgeState]] = {
    State.PRIMARY_STATE_UNCONFIGURED: "init",
    State.PRIMARY_STATE_INACTIVE: "no-comm",
    State.PRIMARY_STATE_ACTIVE: "comm",
    State.PRIMARY_STATE_FINALIZED: "finalized",
}
"""Lifecycle states by the names the robot's state machine gives them."""


class BridgeLink:
    """Follows `servo_bridge` by its transition events and a slow poll; changes its state on request.

    Args:
        node: The node whose executor delivers the answers.
        on_state: Called with every state seen.
        say: Called with one sentence for the person.
    """

    def __init__(
        self, node: Node, on_state: Callable[[BridgeState], None], say: Callable[[str], None]
    ) -> None:
        self._on_state, self._say = on_state, say
        self._get = AsyncService(node, GetState, "servo_bridge/get_state", STATE_WITHIN_S)
        self._change = AsyncService(node, ChangeState, "servo_bridge/change_state")
        node.create_subscription(TransitionEvent, "servo_bridge/transition_event", self._on_event, 10)
        self._state: BridgeState = "not running"
        self._next_poll = 0.0
        self._name = node.resolve_service_name("servo_bridge/change_state").rsplit("/", 1)[0]

    def poll(self, now: float) -> None:
        """Look for the bridge and ask for its state now and then; `now` is a steady clock in [s]."""
        self._get.expire(now)
        self._change.expire(now)
        if now < self._next_poll or self._get.is_busy:
            return
        self._next_poll = now + POLL_INTERVAL_S
        if self._get.is_there:
            self._get.call(GetState.Request(), now, self._on_answer)
        else:
            self._see("not running")

    def toggle(self, now: float) -> None:
        """Start sending (opening the port first where needed), or stop it."""
        if self._change.is_busy:
            self._say("the servo bridge is still changing state")
        elif self._state == "not running" or not self._change.is_there:
            self._say(f"no servo bridge on {self._name}; start it with `softsim run servo_bridge`")
        elif self._state == "init":
            self._request(Transition.TRANSITION_CONFIGURE, now)
        elif self._state == "no-comm":
            self._request(Transition.TRANSITION_ACTIVATE, now)
        elif self._state == "comm":
            self._request(Transition.TRANSITION_DEACTIVATE, now)
        else:
            self._say(f"the servo bridge is {self._state}; nothing was asked of it")

    def _request(self, transition: int, now: float) -> None:
        self._say(_ASKED[transition])
        request = ChangeState.Request()
        request.transition.id = transition
        self._change.call(request, now, lambda answer: self._on_changed(transition, answer, now))

    def _on_changed(self, transition: int, answer: ChangeState.Response | None, now: float) -> None:
        self._next_poll = 0.0
        if answer is None:
            self._say(f"the servo bridge did not answer ({self._name}/change_state)")
        elif not answer.success:
            self._say(_REFUSED[transition])
        elif transition == Transition.TRANSITION_CONFIGURE:
            self._request(Transition.TRANSITION_ACTIVATE, now)
        else:
            self._say(_DONE[transition])

    def _on_event(self, event: TransitionEvent) -> None:
        self._see(STATES.get(event.goal_state.id, "changing"))

    def _on_answer(self, answer: GetState.Response | None) -> None:
        if answer is not None:
            self._see(STATES.get(answer.current_state.id, "changing"))
        elif not self._change.is_busy:  # a bridge that opens its port answers late
            self._see("not running")

    def _see(self, state: BridgeState) -> None:
        self._state = state
        self._on_state(state)


_ASKED = {
    Transition.TRANSITION_CONFIGURE: "opening the servo board's port ...",
    Transition.TRANSITION_ACTIVATE: "starting to send ...",
    Transition.TRANSITION_DEACTIVATE: "stopping to send ...",
}
_DONE = {
    Transition.TRANSITION_ACTIVATE: "sending to the servo board",
    Transition.TRANSITION_DEACTIVATE: "stopped sending to the servo board",
}
_REFUSED = {
    Transition.TRANSITION_CONFIGURE: "the servo bridge could not open its port; its log says why",
    Transition.TRANSITION_ACTIVATE: "the servo bridge refused to send; its log says why",
    Transition.TRANSITION_DEACTIVATE: "the servo bridge refused to stop; its log says why",
}
