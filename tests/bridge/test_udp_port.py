"""A board on the network: driven within its limits, lost and found again, and nobody else is heard."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from board_driving import PacedDriver, robot

from servo_bridge import PortError
from servo_bridge.driver import SerialTransport, open_transport
from servo_bridge.emulator import VirtualBoard


class Network:
    """Carries what the board and its last sender write, as datagrams at a port of this computer.

    Attributes:
        port: The name to open.
        mute: Whether the board's bytes are lost on their way.
    """

    def __init__(self, board: VirtualBoard) -> None:
        self._board = board
        self.mute = False
        self._number = 0
        self.plug_in()

    def plug_in(self) -> None:
        """Receive at the same port as before."""
        self._ended = threading.Event()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", self._number))
        self._number = self._socket.getsockname()[1]
        self.port = f"udp:127.0.0.1:{self._number}"
        self._serial = SerialTransport(self._board.port)
        self._thread = threading.Thread(target=self._carry)
        self._thread.start()

    def _carry(self) -> None:
        sender = None
        while not self._ended.is_set():
            if select.select([self._socket], [], [], 0.0)[0]:
                packet, sender = self._socket.recvfrom(65536)
                self._serial.write(packet)
            data = self._serial.read()
            if data and sender is not None and not self.mute:
                with contextlib.suppress(ConnectionRefusedError):
                    self._socket.sendto(data, sender)

    def unplug(self) -> None:
        """Receive no more; a second call does nothing."""
        self._ended.set()
        self._thread.join()
        self._socket.close()
        self._serial.close()


@pytest.fixture
def network(board: VirtualBoard) -> Iterator[Network]:
    made = Network(board)
    yield made
    made.unplug()


extended = pytest.mark.parametrize("board", ["extended"], indirect=True)


@extended
def test_a_board_on_the_network_is_identified_and_driven_within_its_limits(
    board: VirtualBoard, network: Network, wait_until: Callable[..., bool]
) -> None:
    paced = PacedDriver(robot())
    paced.driver.connect(network.port, quiet_s=0.5)
    assert wait_until(lambda: paced.driver.link_state == "extended")
    paced.driver.start()
    paced.follow([-9.0] * 3, 400)
    assert board.wait_for(lambda b: b.servo_bytes == (63, 63, 63))
    assert board.dropped == 0
    paced.driver.disconnect()


@pytest.mark.slow
@extended
def test_a_bridge_notices_that_the_network_ends_and_takes_up_the_pose_again(
    start_bridge: Callable[..., Any], board: VirtualBoard, network: Network
) -> None:
    bridge = start_bridge(port=network.port, autostart="activate", open_wait_s=2.0)
    assert board.wait_for(lambda b: len(b.packets) > 5)
    network.unplug()
    assert bridge.says(f"no program receives at {network.port}; start the board")
    board.clear()
    network.plug_in()
    assert bridge.says(f"port {network.port} is open again")
    assert board.wait_for(lambda b: len(b.packets) > 5)


@pytest.mark.slow
@extended
def test_a_bridge_notices_that_nothing_comes_back(
    start_bridge: Callable[..., Any], board: VirtualBoard, network: Network
) -> None:
    bridge = start_bridge(port=network.port, autostart="activate", open_wait_s=2.0)
    assert board.wait_for(lambda b: len(b.packets) > 5)
    network.mute = True
    assert bridge.says("no telemetry from the board")


def test_datagrams_of_others_are_not_received() -> None:
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as board,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
    ):
        board.bind(("127.0.0.1", 0))
        transport = open_transport(f"udp:127.0.0.1:{board.getsockname()[1]}", 0)
        transport.write(b"\x01\x02\xff")
        packet, sender = board.recvfrom(100)
        assert packet == b"\x01\x02\xff"
        other.sendto(b"mine", sender)
        for own in (b"first", b"second"):
            board.sendto(own, sender)
        assert [transport.read(), transport.read(), transport.read()] == [b"first", b"second", b""]
        transport.close()
        transport.close()
        for use in (lambda: transport.write(b"x"), transport.read):
            with pytest.raises(PortError, match="failed"):
                use()


def test_two_programs_do_not_drive_the_same_board() -> None:
    first = open_transport("udp:127.0.0.1:4210", 0)
    with pytest.raises(PortError, match=r"port udp:127\.0\.0\.1:4210 is in use by another program"):
        open_transport("udp:127.0.0.1:4210", 0)
    open_transport("udp:127.0.0.1:4211", 0).close()
    first.close()
    open_transport("udp:127.0.0.1:4210", 0).close()


def test_a_board_that_does_not_receive_yet_is_a_message() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as unused:
        unused.bind(("127.0.0.1", 0))
        number = unused.getsockname()[1]
    transport = open_transport(f"udp:127.0.0.1:{number}", 0)
    transport.write(b"x")
    with pytest.raises(PortError, match=f"no program receives at udp:127.0.0.1:{number}; start the board"):
        transport.read()
    transport.close()


@pytest.mark.parametrize(
    "port",
    ["udp:", "udp:host", "udp::5", "udp:127.0.0.1:0", "udp:127.0.0.1:70000", "udp:127.0.0.1:x", "udp:[::1:5",
     "udp:user@127.0.0.1:5", "udp:127.0.0.1:5/a", "udp:127.0.0.1:5?q", "udp:no..host:5"],
)  # fmt: skip
def test_a_name_that_is_no_address_is_refused(port: str) -> None:
    with pytest.raises(PortError, match="cannot be opened: "):
        open_transport(port, 0)
