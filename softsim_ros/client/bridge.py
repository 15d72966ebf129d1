"""Client of the servo bridge: its lifecycle state, starting and stopping it, the e-stop."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Final

from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.node import Node
from std_srvs.srv import Trigger

from softsim_ros import StateListener
from softsim_ros.client.services import AsyncService, Done, Outcome, Request, ignore_outcome, report
from softsim_ros.client.state import BridgeState, RobotSnapshot

STATES: Final[dict[int, BridgeState]] = {
    State.PRIMARY_STATE_UNCONFIGURED: "init",
    State.PRIMARY_STATE_INACTIVE: "no-comm",
    State.PRIMARY_STATE_ACTIVE: "comm",
    State.PRIMARY_STATE_FINALIZED: "finalized",
}
"""Lifecycle states by the names that the robot's state machine gives them."""


class Bridge:
    """Follows `servo_bridge` by its state topics; changes its state on request."""

    def __init__(self, node: Node, snapshot: RobotSnapshot) -> None:
        self._snapshot = snapshot
        self._change = AsyncService(node, ChangeState, "servo_bridge/change_state")
        self._stop = Request(node, Trigger, "servo_bridge/e_stop", "servo bridge", snapshot.say)
        self._clear = Request(node, Trigger, "servo_bridge/clear_e_stop", "servo bridge", snapshot.say)
        StateListener(node, "servo_bridge/state", self._on_state)
        StateListener(
            node, "servo_bridge/e_stop_latched", lambda latched: snapshot.change(e_stopped=bool(latched))
        )
        self._name = self._change.full_name.rsplit("/", 1)[0]

    # --- actions --------------------------------------------------------------------------------------

    def toggle(self, done: Done = ignore_outcome) -> None:
        """Start sending (opening the port first if needed), or stop it."""
        if self._snapshot.state.bridge == "comm":
            self.stop(done)
        else:
            self.start(done)

    def start(self, done: Done = ignore_outcome) -> None:
        """Start sending to the servo board, opening its port first if needed."""
        configure, activate = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE
        self._leave_state({"init": configure, "no-comm": activate}, done)

    def stop(self, done: Done = ignore_outcome) -> None:
        """Stop sending; the servos go to their rest pose first."""
        self._leave_state({"comm": Transition.TRANSITION_DEACTIVATE}, done)

    def e_stop(self, done: Done = ignore_outcome) -> None:
        """Stop the servos where they are; the stop is latched."""
        self._stop.ask(Trigger.Request(), done)

    def clear_e_stop(self, done: Done = ignore_outcome) -> None:
        """Clear the e-stop."""
        self._clear.ask(Trigger.Request(), done)

    # --- its state ------------------------------------------------------------------------------------

    def poll(self, now: float) -> None:
        """Give up calls that have waited too long; `now` is a steady clock in [s]."""
        for service in (self._change, self._stop, self._clear):
            service.expire(now)

    def _on_state(self, state: State | None) -> None:
        self._snapshot.change(bridge="not running" if state is None else STATES.get(state.id, "changing"))

    def _leave_state(self, transitions: Mapping[str, int], done: Done) -> None:
        """Request the transition that leaves the present state, or report why there is none."""
        state = self._snapshot.state.bridge
        if self._change.is_busy:
            self._end(False, "the servo bridge is still changing state", done)
        elif state == "not running" or not self._change.is_there:
            hint = f"no servo bridge on {self._name}; start it with `softsim run servo_bridge`"
            self._end(False, hint, done)
        elif state in transitions:
            self._request(transitions[state], done)
        elif state == "comm":
            self._end(True, "sending to the servo board", done)
        else:
            self._end(False, f"the servo bridge is {state}; nothing was asked of it", done)

    def _end(self, success: bool, message: str, done: Done) -> None:
        report(Outcome(success, message), self._snapshot.say, done)

    def _request(self, transition: int, done: Done) -> None:
        self._snapshot.say(_ASKED[transition])
        request = ChangeState.Request()
        request.transition.id = transition
        self._change.call(
            request, time.monotonic(), lambda answer: self._on_changed(transition, answer, done)
        )

    def _on_changed(self, transition: int, answer: ChangeState.Response | None, done: Done) -> None:
        if answer is None:
            self._end(False, f"the servo bridge did not answer ({self._name}/change_state)", done)
        elif not answer.success:
            self._end(False, _REFUSED[transition], done)
        elif transition == Transition.TRANSITION_CONFIGURE:
            self._request(Transition.TRANSITION_ACTIVATE, done)
        else:
            self._end(True, _DONE[transition], done)


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
