"""The emulated board behind a pseudo-terminal, opened with pyserial."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import serial
from waiting import spin_until

from servo_bridge.driver import byte_to_width
from servo_bridge.emulator import EmulatedBoardPty
from servo_bridge.protocols import FrameParser, FrameType, read_telemetry, set_widths

TOLERANCE_US = 1.5


@pytest.fixture
def port_board(emulator: None, tmp_path: Path) -> Iterator[EmulatedBoardPty]:
    with EmulatedBoardPty(link=tmp_path / "board") as board:
        yield board


def open_port(board: EmulatedBoardPty) -> serial.Serial:
    return serial.Serial(board.port, 115200, timeout=0.05, exclusive=True)


def telemetry_with(port: serial.Serial, seq: int) -> bool:
    """Read until the telemetry acknowledges `seq`."""
    parser = FrameParser()

    def acknowledged() -> bool:
        said = [frame for frame in parser.feed(port.read(64)) if frame.kind is FrameType.TELEMETRY]
        return any(read_telemetry(frame).seq == seq for frame in said)

    return spin_until(acknowledged)


def first_frame(port: serial.Serial) -> FrameType:
    """Kind of the first frame that the board says."""
    parser, kinds = FrameParser(), list[FrameType]()
    assert spin_until(lambda: kinds.extend(frame.kind for frame in parser.feed(port.read(32))) or kinds)
    return kinds[0]


@pytest.mark.slow
def test_opening_resets_the_board_and_the_banner_comes(port_board: EmulatedBoardPty) -> None:
    assert port_board.wait_for(lambda board: board.time_s > 0.05)
    before = port_board.resets
    with open_port(port_board) as port:
        assert first_frame(port) is FrameType.BANNER
        assert port_board.resets == before + 1
        assert port_board.open_count == 1
        port.write(set_widths(7, [1500, 1600, 1700]))
        assert telemetry_with(port, 7)
        assert port_board.wait_for(lambda board: board.widths_us() is not None)
        assert port_board.widths_us() == pytest.approx([1500, 1600, 1700], abs=TOLERANCE_US)
    assert port_board.wait_for(lambda board: not board.is_open)


def test_legacy_packets_move_the_servos(port_board: EmulatedBoardPty) -> None:
    with open_port(port_board) as port:
        assert port_board.wait_for(lambda board: board.is_open)
        port.write(bytes([255, 90, 120, 150]))
        assert port_board.wait_for(lambda board: board.widths_us() is not None)
        ideal = [byte_to_width(value) for value in (90, 120, 150)]
        assert port_board.widths_us() == pytest.approx(ideal, abs=TOLERANCE_US)


def test_unplugged_the_port_vanishes_and_comes_back_behind_the_same_link(
    port_board: EmulatedBoardPty,
) -> None:
    port = open_port(port_board)
    assert port_board.wait_for(lambda board: board.is_open)
    port.write(bytes([255, 90, 120, 150]))
    assert port_board.wait_for(lambda board: board.widths_us() is not None)
    port_board.unplug()
    assert port_board.widths_us() is None
    assert not Path(port_board.port).is_symlink()
    with pytest.raises(OSError, match=r"failed|Errno"):
        port.write(bytes([255, 90, 120, 150]))
    port.close()
    port_board.replug()
    with open_port(port_board) as again:
        assert first_frame(again) is FrameType.BANNER
        assert port_board.wait_for(lambda board: board.open_count == 2)
        assert port_board.widths_us() is None


def test_a_second_opener_is_refused(port_board: EmulatedBoardPty) -> None:
    with open_port(port_board), pytest.raises(serial.SerialException, match="lock"):
        open_port(port_board)


def test_a_killed_board_says_nothing_more(port_board: EmulatedBoardPty) -> None:
    with open_port(port_board) as port:
        assert spin_until(lambda: port.read(8))
        port_board.kill()
        while port.read(64):
            pass
        assert port.read(64) == b""
        assert port_board.failure == ""
