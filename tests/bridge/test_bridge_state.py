"""The bridge's state as data, from its latched topics."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import pytest

pytest.importorskip("rclpy")

from bridge_session import spinning
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_msgs.msg import Float64MultiArray
from waiting import DEADLINE_S

from servo_bridge.driver import EStop
from servo_bridge.nodes import EStopServices, ServoBridge
from softsim_node import STATE_TOPICS
from softsim_ros import StateListener


def bridge_of(client: Any, board: Any) -> ServoBridge:
    """The Tripod's bridge on a board, in this process."""
    overrides = {"port": board.port, "open_wait_s": 0.0, "source": "commands", "robot": "tripod"}
    return ServoBridge(
        context=client.context,
        namespace="tripod",
        parameter_overrides=[Parameter(name, value=value) for name, value in overrides.items()],
    )


@pytest.mark.slow
def test_the_bridge_tells_its_state(
    client: Any, board: Any, stream: Callable[..., Any], wait_until: Callable[..., bool]
) -> None:
    bridge = bridge_of(client, board)
    labels: list[str] = []

    def see(state: Any) -> None:
        labels.append("gone" if state is None else state.label)

    listener = Node("listener", context=client.context, namespace="tripod")
    names = [name for name in STATE_TOPICS if name.startswith("servo_bridge/")]
    heard = {
        name.partition("/")[2]: StateListener(
            listener, name, see if name.endswith("state") else lambda _: None
        )
        for name in names
    }

    def becomes(**wanted: object) -> bool:
        return wait_until(lambda: {name: heard[name].value for name in wanted} == wanted)

    with spinning(listener, client.context):
        with spinning(bridge, client.context):
            assert becomes(connected=False, sending=False, e_stop_latched=False, commanded_by="")
            assert wait_until(lambda: labels == ["unconfigured"])  # each topic is found for itself
            client.transition("configure")
            assert becomes(connected=True, sending=False)
            client.transition("activate")
            assert becomes(sending=True, commanded_by="")
            commands = client.publisher(Float64MultiArray, "position_controller/commands")
            stream(commands, Float64MultiArray(data=[-0.2, -0.2, -0.2]))
            assert becomes(commanded_by="/tripod/position_controller/commands")
            assert client.trigger("servo_bridge/e_stop").success
            assert becomes(e_stop_latched=True, commanded_by="")
            assert client.trigger("servo_bridge/clear_e_stop").success
            assert becomes(e_stop_latched=False, commanded_by="/tripod/position_controller/commands")
            client.transition("deactivate")
            assert becomes(connected=True, sending=False, commanded_by="")
            client.transition("cleanup")
            assert becomes(connected=False)
            assert wait_until(lambda: labels[-1] == "unconfigured")
        assert becomes(state=None, e_stop_latched=None)
    through = ["unconfigured", "configuring", "inactive", "active", "deactivating", "inactive"]
    assert [label for label in labels if label not in ("activating", "cleaningup")][:6] == through


@pytest.mark.slow
def test_the_e_stop_is_served_also_where_it_cannot_be_told(client: Any) -> None:
    def fail() -> None:
        raise RuntimeError("no publisher")

    bridge = Node("servo_bridge", context=client.context, namespace="tripod")
    e_stop = EStop()
    services = EStopServices(bridge, e_stop, lambda: None, fail, str)
    try:
        e_stop.acknowledge()
        assert client.trigger("servo_bridge/e_stop").success
        assert e_stop.latched
        assert client.trigger("servo_bridge/clear_e_stop").success
        assert not e_stop.latched
    finally:
        services.close()
        bridge.destroy_node()


def test_it_stays_latched_where_waiting_commands_cannot_be_dropped(client: Any) -> None:
    def fail() -> None:
        raise RuntimeError("no subscription")

    bridge = Node("servo_bridge", context=client.context, namespace="tripod")
    e_stop = EStop()
    services = EStopServices(bridge, e_stop, fail, lambda: None, str)
    try:
        e_stop.latch()
        answer = client.trigger("servo_bridge/clear_e_stop")
        assert not answer.success
        assert "stays latched: commands that wait cannot be dropped (no subscription" in answer.message
        assert e_stop.latched
    finally:
        services.close()
        bridge.destroy_node()


@pytest.mark.slow
def test_a_command_that_waited_through_a_stop_is_not_followed_after_it(
    client: Any, board: Any, wait_until: Callable[..., bool]
) -> None:
    bridge = bridge_of(client, board)
    busy, gate = threading.Event(), threading.Event()

    def hold() -> None:
        """Keep the bridge's executor from everything else until the gate opens."""
        timer.cancel()
        busy.set()
        gate.wait(DEADLINE_S)

    with spinning(bridge, client.context):
        client.transition("configure")
        client.transition("activate")
        commands = client.publisher(Float64MultiArray, "position_controller/commands")
        heard = client.collect(Float64MultiArray, "position_controller/commands")  # told after the bridge
        timer = bridge.create_timer(0.0, hold)
        assert wait_until(busy.is_set)
        commands.publish(Float64MultiArray(data=[-2.0] * 3))
        assert wait_until(lambda: heard)
        assert client.trigger("servo_bridge/e_stop").success
        assert client.trigger("servo_bridge/clear_e_stop").success
        gate.set()
        assert client.state() == "active"
        board.clear()
        assert board.wait_for(lambda b: len(b.packets) >= 20)
        assert {packet.servo_bytes for packet in board.packets} == {(150, 150, 150)}
        commands.publish(Float64MultiArray(data=[-1.0] * 3))
        assert board.wait_for(lambda b: b.servo_bytes == (121, 121, 121))
