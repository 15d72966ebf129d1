"""A port or a protocol that blocks for ever takes the thread that sends, and nothing else of the bridge."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy")

from board_driving import robot
from bridge_session import spinning
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_msgs.msg import Float64MultiArray

from servo_bridge.driver import HANG_S, HangDetector, PeriodicThread, SerialTransport
from servo_bridge.emulator import VirtualBoard
from servo_bridge.nodes import ServoBridge
from servo_bridge.protocols import LegacyProtocol
from softsim_ros import StateListener

Wait = Callable[..., bool]


@pytest.fixture
def blocks(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[type, str], None]]:
    """Makes a method block from now on, for everybody, until the end of the test."""
    gate = threading.Event()

    def block(owner: type, method: str) -> None:
        plain = getattr(owner, method)

        def blocked(*arguments: Any) -> Any:
            gate.wait()
            return plain(*arguments)

        monkeypatch.setattr(owner, method, blocked)

    yield block
    gate.set()


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.parametrize(("owner", "method"), [(SerialTransport, "write"), (LegacyProtocol, "encode_pose")])
def test_it_is_found_said_and_given_up(
    client: Any,
    board: VirtualBoard,
    wait_until: Wait,
    stream: Callable[..., Any],
    blocks: Callable[[type, str], None],
    owner: type,
    method: str,
) -> None:
    overrides = {"port": board.port, "autostart": "activate", "source": "commands", "open_wait_s": 0.0}
    bridge = ServoBridge(
        scene=robot(),
        context=client.context,
        namespace="tripod",
        parameter_overrides=[Parameter(name, value=value) for name, value in overrides.items()],
    )
    diagnostics = client.collect(DiagnosticArray, "/diagnostics")
    listener = Node("listener", context=client.context, namespace="tripod")
    facts = ("connected", "sending")
    heard = {name: StateListener(listener, f"servo_bridge/{name}", lambda _: None) for name in facts}

    def told(**wanted: bool) -> bool:
        return wait_until(lambda: {name: each.value for name, each in heard.items()} == wanted)

    def reported() -> bool:
        return any(
            status.level == DiagnosticStatus.ERROR and "hangs" in status.message
            for message in diagnostics
            for status in message.status
        )

    with spinning(listener, client.context), spinning(bridge, client.context):
        commands = client.publisher(Float64MultiArray, "position_controller/commands")
        stream(commands, Float64MultiArray(data=[-1.0] * 3))
        assert board.wait_for(lambda b: b.servo_bytes == (121,) * 3)
        assert told(connected=True, sending=True)
        blocks(owner, method)
        assert "no packet could leave" in client.trigger("servo_bridge/e_stop").message
        assert client.trigger("servo_bridge/clear_e_stop").success
        assert wait_until(lambda: bridge.lifecycle_state == "inactive")
        assert told(connected=False, sending=False)
        assert wait_until(reported)
        assert client.refuses("activate")
        client.transition("cleanup")
        assert client.state() == "unconfigured"


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.parametrize("words", ["deactivate", "close"])
def test_the_way_out_ends_though_the_port_blocks(
    client: Any, board: VirtualBoard, wait_until: Wait, blocks: Callable[[type, str], None], words: str
) -> None:
    overrides = {"port": board.port, "autostart": "activate", "open_wait_s": 0.0}
    bridge = ServoBridge(
        scene=robot(),
        context=client.context,
        namespace="tripod",
        parameter_overrides=[Parameter(name, value=value) for name, value in overrides.items()],
    )
    with spinning(bridge, client.context):
        assert board.wait_for(lambda b: b.accepted > 5)
        blocks(SerialTransport, "write")
        if words != "close":
            client.transition(words)
        bridge.close()


def test_a_call_hangs_after_looks_and_not_because_nobody_looked() -> None:
    now, gate = [0.0], threading.Event()
    began = threading.Event()

    def tick() -> None:
        began.set()
        gate.wait()

    thread = PeriodicThread(tick, 0.01)
    assert began.wait(60.0)
    watch = HangDetector(thread, lambda: now[0])
    assert not watch.look()
    now[0] = 3600.0  # the computer slept
    assert not watch.look()
    looks = 0
    while not watch.look():
        now[0] += 0.1
        looks += 1
    assert HANG_S * 0.8 <= 0.1 * looks <= HANG_S
    assert not thread.join(0.01)
    gate.set()
    thread.stop()
    assert thread.join()
    assert not watch.look()
