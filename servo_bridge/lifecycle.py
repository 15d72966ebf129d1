"""A lifecycle node that answers an impossible transition with false instead of ending."""

from __future__ import annotations

from typing import Any

from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNode

from servo_bridge.wording import shortened
from softsim_core.errors import listing
from softsim_node.guarded_node import GuardedNode


class GuardedLifecycleNode(GuardedNode, LifecycleNode):
    """rclpy's LifecycleNode behind doors, and safe against transitions that the present state does not have.

    rclpy raises from the service's callback then, which ends the process: any `ros2 lifecycle set` typed in
    the wrong state would stop a robot.
    """

    def __init__(self, node_name: str, **node_kwargs: Any) -> None:
        super().__init__(node_name, **node_kwargs)
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self._on_change_state

    @property
    def lifecycle_state(self) -> str:
        """Present lifecycle state: unconfigured, inactive, active, finalized, or a transition's."""
        return str(self.state_message().label)

    def state_message(self) -> State:
        """Present lifecycle state with its number."""
        number, label = self._state_machine.current_state
        return State(id=number, label=label)

    def _on_change_state(
        self, request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        offered = {transition[0]: transition[1] for transition in self._state_machine.available_transitions}
        label = request.transition.label
        if (label in offered.values()) if label else (request.transition.id in offered):
            return self._change_state(request, response)
        self.get_logger().error(
            f"transition {shortened(label) or request.transition.id} refused in state {self.lifecycle_state};"
            f" possible are: {listing(sorted(set(offered.values())))}"
        )
        response.success = False
        return response
