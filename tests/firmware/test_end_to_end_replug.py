"""A board that comes back under another number is found by its name in /dev/serial/by-id, and driven on."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from bridge.conftest import Client
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter

from servo_bridge import bridge_node
from servo_bridge.emulator import EmulatedBoardPty
from servo_bridge.frames import byte_to_width
from servo_bridge.port_link import make_link
from servo_bridge.ports import stable_name

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.usefixtures("emulator")]

REST_US = byte_to_width(150)
DEADLINE_S = 60.0


@pytest.fixture
def client(ros_domain: int) -> Iterator[Client]:
    made = Client(ros_domain)
    yield made
    made.close()


def rests(board: EmulatedBoardPty) -> bool:
    widths = board.widths_us()
    return widths is not None and all(abs(width - REST_US) < 1.5 for width in widths)


def test_replugged_under_another_number(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, client: Client
) -> None:
    monkeypatch.setattr(bridge_node, "stable_name", partial(stable_name, by_id=tmp_path))
    name = tmp_path / "usb-Arduino_Uno_tripod-if00"
    with EmulatedBoardPty(link=name) as before, EmulatedBoardPty() as after:
        number = str(name.readlink())
        assert number != after.port
        overrides = {"port": number, "autostart": "activate", "source": "commands"}
        bridge = bridge_node.ServoBridge(
            context=client.context,
            namespace="tripod",
            parameter_overrides=[Parameter(key, value=value) for key, value in overrides.items()],
        )
        executor = SingleThreadedExecutor(context=client.context)
        executor.add_node(bridge)
        stop = threading.Event()

        def spin() -> None:
            while not stop.is_set():
                executor.spin_once(timeout_sec=0.05)

        spinner = threading.Thread(target=spin)
        spinner.start()
        try:
            assert before.wait_for(rests, DEADLINE_S), before.widths_us()
            before.unplug()
            make_link(name, after.port)
            assert after.wait_for(rests, DEADLINE_S), after.widths_us()
            assert after.open_count == 1
        finally:
            bridge.close()
            stop.set()
            spinner.join()
            executor.shutdown()
            bridge.destroy_node()
