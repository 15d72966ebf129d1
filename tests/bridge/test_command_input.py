"""Commands that wait to be read while the bridge is busy: followed, or forgotten where it begins anew."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

pytest.importorskip("rclpy")

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray

from servo_bridge.nodes import CommandInput


class Driver:
    """Takes commands, and nothing else."""

    def __init__(self) -> None:
        self.commands: list[Any] = []

    def command(self, values: Any) -> None:
        self.commands.append(values)


@pytest.mark.parametrize("forgotten", [False, True])
def test_what_waited_is_followed_unless_it_is_forgotten(
    ros_domain: int, wait_until: Callable[..., bool], monkeypatch: pytest.MonkeyPatch, forgotten: bool
) -> None:
    context = Context()
    rclpy.init(context=context, domain_id=ros_domain)
    node, driver = Node("bridge", context=context), Driver()
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    monkeypatch.setattr("servo_bridge.driver.driver.ServoDriver.command", Driver.command)
    given: Any = driver
    commands = CommandInput(node, "commands", lambda: given)
    heard: list[Any] = []
    topic = "position_controller/commands"
    witness = node.create_subscription(Float64MultiArray, topic, heard.append, 1)
    publisher = node.create_publisher(Float64MultiArray, topic, 1)
    try:
        assert wait_until(lambda: publisher.get_subscription_count() == 2)
        publisher.publish(Float64MultiArray(data=[-2.0] * 3))

        def arrived() -> bool:
            """Whether it waits: the witness is told after the input, and is read by hand."""
            with witness.handle:
                return witness.handle.take_message(Float64MultiArray, False) is not None

        assert wait_until(arrived)
        if forgotten:
            commands.forget()
        for _ in range(20):
            executor.spin_once(0.01)
        assert len(driver.commands) == (0 if forgotten else 1)
        publisher.publish(Float64MultiArray(data=[-1.0] * 3))  # the next one is followed either way

        def followed() -> bool:
            executor.spin_once(0.01)
            return len(driver.commands) == (1 if forgotten else 2)

        assert wait_until(followed)
    finally:
        executor.shutdown()
        node.destroy_node()
        context.try_shutdown()
