"""The virtual board: what a program at the other end of the line sees."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from servo_bridge import PortError
from servo_bridge.driver import SerialTransport
from servo_bridge.emulator import VirtualBoard


def test_it_starts_without_pulses_and_keeps_the_last_pose(board: VirtualBoard) -> None:
    assert board.servo_bytes is None
    with SerialTransport(board.port) as transport:
        transport.write(bytes([255, 60, 120, 180]))
        assert board.wait_for(lambda b: b.accepted == 1)
    assert board.wait_for(lambda b: not b.is_open)
    assert board.servo_bytes == (60, 120, 180)


def test_bad_bytes_are_dropped_and_counted(board: VirtualBoard) -> None:
    with SerialTransport(board.port) as transport:
        transport.write(bytes([255, 60, 59, 180, 13, 10, 255, 90, 255, 91, 92, 93]))
        assert board.wait_for(lambda b: b.received == 12)
    assert [packet.servo_bytes for packet in board.packets] == [(91, 92, 93)]
    assert board.dropped == 2


def test_opening_forgets_a_packet_begun(board: VirtualBoard) -> None:
    for count, piece in enumerate((b"\xff\x5a\x5a", b"\x5a"), start=1):
        with SerialTransport(board.port) as transport:
            assert board.wait_for(lambda b, count=count: b.open_count == count)
            transport.write(piece)
        assert board.wait_for(lambda b: not b.is_open)
    assert board.wait_for(lambda b: b.received == 4)
    assert board.accepted == 0


def test_it_never_answers_nor_echoes(board: VirtualBoard) -> None:
    with SerialTransport(board.port) as transport:
        transport.write(bytes([255, 90, 90, 90, 10, 13]))
        assert board.wait_for(lambda b: b.received == 6)
        assert transport.read() == b""


def test_replug_keeps_the_link_and_loses_the_pose(board: VirtualBoard) -> None:
    with SerialTransport(board.port) as transport:
        transport.write(bytes([255, 90, 90, 90]))
        assert board.wait_for(lambda b: b.servo_bytes == (90, 90, 90))
        board.unplug()
        assert not os.path.lexists(board.port)
        with pytest.raises(PortError):
            transport.write(bytes([255, 90, 90, 90]))
    board.replug()
    assert board.servo_bytes is None
    with SerialTransport(board.port) as transport:
        transport.write(bytes([255, 91, 91, 91]))
        assert board.wait_for(lambda b: b.servo_bytes == (91, 91, 91))


def test_waiting_has_a_deadline(board: VirtualBoard) -> None:
    assert not board.wait_for(lambda b: b.accepted > 0, deadline_s=0.05)


def test_the_link_never_replaces_a_file(tmp_path: Path) -> None:
    file = tmp_path / "precious"
    file.write_text("data")
    with pytest.raises(PortError, match="is no link"):
        VirtualBoard(link=file)
    with pytest.raises(PortError, match="cannot be made"):
        VirtualBoard(link=tmp_path / "absent" / "link")
    assert file.read_text() == "data"


def test_closing_removes_the_link_and_every_descriptor(tmp_path: Path) -> None:
    before = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(5):
        with VirtualBoard(link=tmp_path / "link") as board:
            board.unplug()
            board.replug()
        board.close()
    assert len(list(Path("/proc/self/fd").iterdir())) == before
    assert list(tmp_path.iterdir()) == []


def test_a_stale_link_of_a_killed_board_is_taken_over(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "gone")
    with VirtualBoard(link=tmp_path / "link") as board, SerialTransport(board.port):
        assert board.wait_for(lambda b: b.is_open)


@pytest.mark.ros
def test_as_a_node_it_remembers_a_hundred_packets(ros_domain: int) -> None:
    """It runs for days: all packets of a minute at 50 Hz are 0.43 MB."""
    context_module = pytest.importorskip("rclpy.context")
    from servo_bridge.nodes import LOG_LENGTH, VirtualBoardNode

    context = context_module.Context()
    context.init(args=[], domain_id=ros_domain)
    node = VirtualBoardNode(context=context)
    try:
        with SerialTransport(node.board.port) as transport:
            for count in range(1, 31):
                transport.write(10 * bytes([255, 60, 120, 180]))
                assert node.board.wait_for(lambda b, count=count: b.accepted == 10 * count)
        assert len(node.board.packets) == LOG_LENGTH
    finally:
        node.destroy_node()
        context.try_shutdown()
