"""Services of the bridge: lifecycle transitions, the e-stop and its release."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable
from typing import Any

from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import ChangeState
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from std_srvs.srv import Trigger

from servo_bridge.driver import EStop
from softsim_core.base import listing, shorten
from softsim_node import GuardedNode, error_text, spin


class GuardedLifecycleNode(GuardedNode, LifecycleNode):
    """LifecycleNode of rclpy with callback guards, which refuses invalid transitions.

    rclpy raises from the service's callback if the present state does not have a transition. That would end
    the process: any `ros2 lifecycle set` typed in the wrong state would stop a robot.
    """

    def __init__(self, node_name: str, **node_kwargs: Any) -> None:
        super().__init__(node_name, **node_kwargs)
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self._on_change_state

    @property
    def lifecycle_state(self) -> str:
        """Present lifecycle state: unconfigured, inactive, active, finalized, or that of a transition."""
        return str(self.state_message().label)

    def state_message(self) -> State:
        """Return the present lifecycle state with its number."""
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
            f"transition {shorten(label) or request.transition.id} refused in state {self.lifecycle_state};"
            f" possible are: {listing(sorted(set(offered.values())))}"
        )
        response.success = False
        return response


# Longest wait in [s] for the packet that carries the stop: longer than a period of the slowest rate
ACKNOWLEDGE_TIMEOUT_S = 0.25

# Time in [s] that the node outlives its last response: an unread response is lost when the process ends
ARRIVES_S = 0.5


class EStopServices:
    """The services `~/e_stop` and `~/clear_e_stop`, on a node, an executor and a thread of their own.

    Both only set a latch. A stop is answered when the packet that carries it was sent, or when it is clear
    that there is none.

    Args:
        bridge: Node whose name and remappings the services use, and whose log they write.
        forget: Called before the latch is cleared; drops earlier commands that are still queued.
        changed: Called in that thread after the latch was set or cleared.
        describe_stop: Returns a message about what was sent to the board at a stop; its argument says whether
            the latch was acknowledged.
    """

    def __init__(
        self,
        bridge: Node,
        e_stop: EStop,
        forget: Callable[[], None],
        changed: Callable[[], None],
        describe_stop: Callable[[bool], str],
    ) -> None:
        self._e_stop, self._logger, self._forget = e_stop, bridge.get_logger(), forget
        self._changed, self._describe_stop = changed, describe_stop
        self._node = Node(
            f"{bridge.get_name()}_e_stop",
            context=bridge.context,
            namespace=bridge.get_namespace(),
            use_global_arguments=False,
            start_parameter_services=False,
            enable_rosout=False,
        )
        for name, answer in (("~/e_stop", self._latch), ("~/clear_e_stop", self._clear)):
            self._node.create_service(Trigger, bridge.resolve_service_name(name), answer)
        self._executor = SingleThreadedExecutor(context=bridge.context)
        self._executor.add_node(self._node)
        self._stop = threading.Event()
        self._answered = -math.inf
        going = (self._executor, lambda: not self._stop.is_set())
        self._thread = threading.Thread(target=spin, args=going, name="servo_bridge_e_stop", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread, then the node once its last response can have arrived; idempotent."""
        if self._stop.is_set():
            return
        self._stop.set()
        self._thread.join()
        time.sleep(max(0.0, self._answered + ARRIVES_S - time.monotonic()))
        self._executor.shutdown(timeout_sec=0)
        self._node.destroy_node()

    def _latch(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._e_stop.latch()
        acknowledged = self._e_stop.wait_acknowledged(ACKNOWLEDGE_TIMEOUT_S)
        self._notify()
        response.success, response.message = True, f"e-stop latched: {self._describe_stop(acknowledged)}"
        self._logger.warning(response.message)
        self._answered = time.monotonic()
        return response

    def _clear(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            self._forget()
        except Exception as error:
            message = f"the e-stop stays latched: commands that wait cannot be dropped ({error_text(error)})"
            response.success, response.message = False, message
            self._logger.error(message)
        else:
            self._e_stop.clear()
            self._notify()
            response.success, response.message = True, "e-stop cleared: the next command moves the servos"
            self._logger.info(response.message)
        self._answered = time.monotonic()
        return response

    def _notify(self) -> None:
        with contextlib.suppress(Exception):  # the services must survive any error of the notification
            self._changed()
