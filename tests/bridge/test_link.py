"""Detection, telemetry and the loss of a board, on a clock of the test's own and with bytes by hand."""

from __future__ import annotations

import math
import threading

import pytest

from servo_bridge import PortError
from servo_bridge.driver import BoardLink, Reader
from servo_bridge.protocols import Banner, BoardFlags, Telemetry, candidates, frames, reset_cause_text
from softsim_core.scene import BoardDescription, ServoCalibration

BOARD = BoardDescription(servos=tuple(ServoCalibration(joint=name) for name in "abc"))
BANNER = frames.banner(0, Banner(frames.PROTOCOL_VERSION, 2, 0, 2))
REST = (2091,) * 3


def said(seq: int = 0, flags: BoardFlags = BoardFlags.LINK, widths: tuple[int, ...] = REST) -> bytes:
    return frames.telemetry(0, Telemetry(seq, flags, widths, 0, 0))


def opened(protocol: str = "auto") -> BoardLink:
    return BoardLink("/dev/board", [each(BOARD) for each in candidates(protocol, BOARD)], 2.5, 10.0)


def test_silence_is_a_legacy_board_after_the_quiet_time() -> None:
    link = opened()
    assert link.state(12.49) == "waiting"
    link.receive(b"", 12.5)
    assert link.state(12.5) == "legacy"
    link.check(1000.0)


def test_text_of_another_firmware_is_a_legacy_board() -> None:
    link = opened()
    link.receive(b"Orientation Sensor Test\r\n\xff\xfe\x81", 11.0)
    assert link.state(12.4) == "waiting"
    assert link.state(12.6) == "legacy"


@pytest.mark.parametrize("first", [BANNER, b""])
def test_a_banner_or_telemetry_is_an_extended_board_at_once(first: bytes) -> None:
    link = opened()
    link.receive(first, 11.40)
    assert link.state(11.41) == "waiting"
    link.receive(said(), 11.45)
    assert link.state(11.46) == "extended"
    assert link.take_restart()
    assert not link.take_restart()


def test_a_banner_alone_is_waited_with_beyond_the_quiet_time() -> None:
    link = opened()
    link.receive(BANNER, 12.4)
    assert link.state(12.6) == "waiting"


def test_a_board_that_speaks_late_is_an_extended_board_from_then_on() -> None:
    link = opened()
    assert link.state(13.0) == "legacy"
    link.receive(BANNER + said(), 13.1)
    assert link.state(13.1) == "extended"
    assert link.take_restart()


@pytest.mark.parametrize("protocol", ["legacy", "ascii_imu"])
def test_a_protocol_that_is_demanded_is_kept_whatever_the_board_says(protocol: str) -> None:
    link = opened(protocol)
    link.receive(BANNER + said(), 11.0)
    assert link.state(12.0) == "waiting"
    assert link.state(12.6) == protocol
    link.check(100.0)


def test_an_extended_board_that_is_demanded_and_absent_is_a_sentence() -> None:
    link = opened("extended")
    link.check(13.4)
    assert link.state(13.4) == "waiting"
    with pytest.raises(PortError, match=r"answered on /dev/board within 3\.5 s; flash its firmware"):
        link.check(13.6)


def test_a_board_of_another_version_is_a_sentence() -> None:
    link = opened()
    link.receive(frames.banner(0, Banner(1, 1, 0, 0)), 11.0)
    with pytest.raises(PortError, match="speaks version 1 of the extended protocol, this bridge version 2"):
        link.check(11.0)


def test_a_computer_that_slept_has_not_lost_its_board() -> None:
    link = opened()
    link.receive(said(), 11.0)
    link.receive(b"", 3611.0)
    link.check(3611.0)
    link.receive(said(), 3611.05)
    for look in range(1, 10):
        link.receive(b"", 3611.05 + 0.05 * look)
    link.check(3611.5)


def test_half_a_second_without_telemetry_is_a_lost_board() -> None:
    link = opened()
    link.receive(said(), 11.0)
    for look in range(1, 11):
        link.receive(b"", 11.0 + 0.05 * look)
    link.check(11.5)
    link.receive(b"", 11.51)
    with pytest.raises(PortError, match=r"no telemetry from the board on /dev/board for 0\.5 s"):
        link.check(11.51)


def test_a_computer_that_stood_still_does_not_lose_its_board() -> None:
    link = opened()
    link.receive(said(), 11.0)
    link.check(30.0)  # nobody has looked at the port since
    link.receive(said(), 30.1)
    link.check(30.1)


def test_a_reset_on_the_way_is_noticed_and_its_pose_not_believed_before_new_telemetry() -> None:
    link = opened()
    link.receive(BANNER + said(), 11.0)
    assert link.take_restart()
    link.receive(frames.banner(0, Banner(frames.PROTOCOL_VERSION, 2, 0, 8)), 12.0)
    assert link.state(12.0) == "waiting"
    link.receive(said(), 12.05)
    assert link.state(12.05) == "extended"
    assert link.take_restart()
    assert link.board.banners == 2
    assert link.board.banner is not None
    assert reset_cause_text(link.board.banner.reset_cause) == "watchdog"


def test_acknowledgements_are_counted_around_the_wrap_of_the_sequence() -> None:
    link = opened()
    link.receive(said(), 11.0)
    for sent, acknowledged, open_frames in ((63, 62, 1), (1, 62, 3), (2, 2, 0)):
        link.board.seq = sent
        link.receive(said(acknowledged), 11.1)
        assert link.board.unacknowledged == open_frames
    assert link.board.most_unacknowledged == 3
    assert link.board.telemetry_frames == 4


def test_damaged_telemetry_is_counted_and_not_used() -> None:
    link = opened("extended")
    data = bytearray(said(5))
    data[4] ^= 1
    link.receive(bytes(data), 11.0)
    assert link.board.telemetry is None
    assert link.board.frames_dropped == 1


def test_lines_of_an_imu_are_read_whatever_stands_around_them() -> None:
    link = opened()
    readings = link.receive(b"hello\r\n" + said() + b"1.0,2.0,\r\n" + said(), 11.0)
    assert [round(math.degrees(reading.tilt_x), 9) for reading in readings] == [2.0]
    assert link.tilt_age(11.5) == 0.5
    assert link.board.telemetry_frames == 2


def test_every_reset_cause_has_words() -> None:
    assert reset_cause_text(1 | 4) == "power-on, brown-out"
    assert reset_cause_text(0) == "unknown (0)"


class Line:
    """A port in memory: gives its pieces, then waits for more or fails."""

    def __init__(self, pieces: list[bytes], end: PortError | None = None) -> None:
        self._pieces, self._end = pieces, end
        self._more = threading.Event()

    def read(self) -> bytes:
        if self._pieces:
            return self._pieces.pop(0)
        if self._end is not None:
            raise self._end
        self._more.wait()
        return b""

    def cancel_read(self) -> None:
        self._more.set()


def test_the_reader_hands_on_every_piece_and_the_end() -> None:
    link, tilts = opened(), []
    data = BANNER + b"\r\n1.0,2.0,\r\n" + said()
    failed = threading.Event()
    fail = link.fail
    link.fail = lambda error: (fail(error), failed.set())[0]  # type: ignore[method-assign]
    line = Line([data[:5], data[5:]], PortError("/dev/board", "port /dev/board vanished"))
    reader = Reader(line, link, lambda: 11.0, tilts.append)
    assert failed.wait(60.0)
    reader.stop()
    assert link.state(11.0) == "extended"
    assert len(tilts) == 1
    with pytest.raises(PortError, match="vanished"):
        link.check(11.0)


def test_the_reader_ends_though_nothing_comes() -> None:
    Reader(Line([]), opened(), lambda: 11.0).stop()
