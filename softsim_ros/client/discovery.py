"""Find running robots: namespaces with a simulator or a servo bridge, and the robots in them."""

from __future__ import annotations

import time
from typing import Final, NamedTuple

from rcl_interfaces.srv import GetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python

from softsim_core.base import SoftSimError, listing
from softsim_node import ending

PEERS = ("simulator", "servo_bridge")

FIRST_WITHIN_S: Final = 4.0
"""Longest wait for the first sign of a robot in [s]; announcements repeat after 3 s."""

OTHERS_S: Final = 3.2
"""Longest time in [s] between the discoveries of two robots; announcements repeat after 3 s."""

ANSWER_S: Final = 2.0
"""Longest wait in [s] for a node's answer about its robot."""

_TURN_S: Final = 0.05


class RobotChoiceError(SoftSimError):
    """Several robots run, and none was chosen."""


class RunningRobot(NamedTuple):
    """A running robot: name or file from the parameter `robot` of its simulator or bridge, and its namespace.

    The name is empty if no node answered and the namespace is "/", which names no robot.
    """

    robot: str
    namespace: str


def running_robots(node: Node) -> list[str]:
    """Return the namespaces of the robots that `node` has discovered, such as "/tripod", sorted."""
    return sorted({space for name, space in node.get_node_names_and_namespaces() if name in PEERS})


def running_robot(
    namespace: str | None = None, domain: int | None = None, within_s: float = FIRST_WITHIN_S
) -> RunningRobot | None:
    """Return the running robot, or None if there is none.

    Args:
        namespace: Where to look; None: anywhere.
        domain: ROS domain; None: that of the environment.
        within_s: Longest wait for the first one in [s].

    Raises:
        RobotChoiceError: there are several.
    """
    context = Context()
    context.init(args=["--ros-args", "--disable-rosout-logs"], domain_id=domain)
    node = Node("_softsim_look", context=context, use_global_arguments=False, enable_rosout=False)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    try:
        spaces = _await_namespaces(node, executor, namespace, within_s)
        if len(spaces) > 1:
            raise RobotChoiceError(f"several robots run: {listing(spaces)}; name the one that is meant")
        if not spaces:
            return None
        return RunningRobot(_robot_in(node, executor, spaces[0]) or spaces[0].strip("/"), spaces[0])
    finally:
        executor.shutdown()
        node.destroy_node()
        context.try_shutdown()


def _await_namespaces(
    node: Node, executor: SingleThreadedExecutor, namespace: str | None, within_s: float
) -> list[str]:
    """Return the namespaces of robots once no more appear; for a named one, wait for it alone."""
    requested_name = None if namespace is None else f"/{namespace.strip('/')}"
    found: list[str] = []
    began = changed = time.monotonic()
    while not ending.asked:
        executor.spin_once(timeout_sec=_TURN_S)
        newer = [each for each in running_robots(node) if requested_name in (None, each)]
        now = time.monotonic()
        if newer != found:
            found, changed = newer, now
        if (requested_name is not None or now - changed > OTHERS_S) if found else now - began > within_s:
            break
    return found


def _robot_in(node: Node, executor: SingleThreadedExecutor, space: str) -> str:
    """Return the parameter `robot` of a simulator or bridge there; an empty string without an answer."""
    names = {name for name, each in node.get_node_names_and_namespaces() if each == space}
    for peer in PEERS:
        if peer not in names:
            continue
        client = node.create_client(GetParameters, f"{space.rstrip('/')}/{peer}/get_parameters")
        end = time.monotonic() + ANSWER_S
        while not client.service_is_ready() and time.monotonic() < end and not ending.asked:
            executor.spin_once(timeout_sec=_TURN_S)
        future = client.call_async(GetParameters.Request(names=["robot"]))
        while not future.done() and time.monotonic() < end and not ending.asked:
            executor.spin_once(timeout_sec=_TURN_S)
        if future.done() and (answer := future.result()) is not None and answer.values:
            return str(parameter_value_to_python(answer.values[0]) or "")
    return ""
