"""The scene that edits propose, as a client sees it: edits out, the proposal in, apply, save, undo."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Final

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import Trigger

from softsim_core.editing import Edit
from softsim_core.errors import SoftSimError
from softsim_ros.client.services import Done, Request, unheeded
from softsim_ros.messages.proposal import Proposal, read_proposal, write_edits
from softsim_ros.qos import EVERY_ONE, LATCHED

EXPIRE_PERIOD_S: Final = 1.0
APPLIED_WITHIN_S: Final = 60.0
"""A proposal is built within this time in [s]; its kernels may have to be compiled."""

TOLD_WITHIN_S: Final = 8.0
"""What edits propose is told within this time in [s], or they were lost with their simulator."""

ACTIONS: Final = ("begin", "undo", "redo", "discard", "apply", "save", "copy")
"""What can be asked for by name, see docs/edit.md."""


class Editing:
    """Edits the scene of `simulator` in the node's namespace.

    Args:
        node: The node whose executor delivers messages and answers.
        say: Called with sentences for the person.

    Attributes:
        proposal: The newest that was told; None: none was.
    """

    def __init__(self, node: Node, say: Callable[[str], None]) -> None:
        self._say = say
        self._edits = node.create_publisher(String, "scene/edit", EVERY_ONE)
        node.create_subscription(String, "scene/proposal", self._on_proposal, LATCHED)
        self._requests = {
            name: Request(node, Trigger, f"simulator/edit/{name}", "simulator", say, APPLIED_WITHIN_S)
            for name in ACTIONS
        }
        self.proposal: Proposal | None = None
        self._untold_since: float | None = None
        node.create_timer(EXPIRE_PERIOD_S, self._expire, clock=Clock(clock_type=ClockType.STEADY_TIME))

    @property
    def is_behind(self) -> bool:
        """Something was asked for whose outcome is not known yet: an edit made now is one of an old scene."""
        return self._untold_since is not None or any(each.is_busy for each in self._requests.values())

    def change(self, edits: Sequence[Edit], stroke: str = "") -> None:
        """Propose edits, which are undone together; those in a row with the same stroke, too."""
        self._edits.publish(String(data=write_edits(edits, stroke)))
        self._untold_since = time.monotonic()

    def ask(self, name: str, done: Done = unheeded) -> None:
        """Ask for one of ACTIONS."""
        self._requests[name].ask(Trigger.Request(), done)

    def _expire(self) -> None:
        """Give up what has waited too long."""
        now = time.monotonic()
        for request in self._requests.values():
            request.expire(now)
        if self._untold_since is not None and now - self._untold_since > TOLD_WITHIN_S:
            self._untold_since = None

    def _on_proposal(self, message: String) -> None:
        self._untold_since = None
        try:
            told = read_proposal(message.data)
        except SoftSimError as error:
            self._say(str(error))
            return
        if self.proposal is None or told.revision > self.proposal.revision:
            self.proposal = told
            if told.sentence:
                self._say(told.sentence)
