"""The serial port on a real pseudo-terminal: exclusive, tolerant, and clear about what is wrong."""

from __future__ import annotations

import errno
import os
import tty
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
import serial

from servo_bridge import PortError
from servo_bridge.driver import (
    SerialTransport,
    find_port,
    find_same_device,
    open_transport,
    opening_error_message,
    stable_name,
)
from servo_bridge.emulator import VirtualBoard

REST = bytes([255, 150, 150, 150])


def test_a_packet_reaches_the_board(board: VirtualBoard) -> None:
    with SerialTransport(board.port) as transport:
        transport.write(bytes([255, 93, 121, 134]))
        assert board.wait_for(lambda b: b.servo_bytes == (93, 121, 134))
        assert board.is_open
    assert board.wait_for(lambda b: not b.is_open)
    assert not transport.is_open


def test_what_the_board_says_is_read_and_dropped(wait_until: Callable[..., bool]) -> None:
    master, slave = os.openpty()
    tty.setraw(slave)
    with SerialTransport(os.ttyname(slave)) as transport:
        os.write(master, b"Orientation Sensor Test\r\n")
        assert wait_until(lambda: transport.read())  # the line hands it over in its own time
        assert transport.read() == b""
    os.close(master)
    os.close(slave)


def test_a_second_opener_is_refused_both_ways(board: VirtualBoard) -> None:
    with SerialTransport(board.port):
        with pytest.raises(PortError, match="in use by another program"):
            SerialTransport(board.port)
        with pytest.raises(serial.SerialException, match="exclusively"):
            serial.Serial(board.port, exclusive=True)
    SerialTransport(board.port).close()


def test_a_missing_port_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(PortError, match=r"ttyACM7 does not exist; plug the board in, or .* parameter port"):
        SerialTransport(str(tmp_path / "ttyACM7"))


def test_a_missing_usb_serial_adapter_mentions_brltty(tmp_path: Path) -> None:
    with pytest.raises(PortError, match="brltty"):
        SerialTransport(str(tmp_path / "ttyUSB0"))


def test_a_link_to_nothing_says_that_no_device_is_there(tmp_path: Path) -> None:
    link = tmp_path / "tripod"
    link.symlink_to(tmp_path / "gone")
    with pytest.raises(PortError, match="has no device behind it"):
        SerialTransport(str(link))


def test_no_port_is_said_to_be_missing_by_its_name() -> None:
    with pytest.raises(
        PortError, match=r"^no port is named; name the board's .*find_port\(\) search for it$"
    ):
        open_transport("", 115_200)


def test_files_and_folders_are_no_serial_ports(tmp_path: Path) -> None:
    file = tmp_path / "notes.txt"
    file.write_text("")
    for path in (file, tmp_path):
        with pytest.raises(PortError, match="is not a serial port"):
            SerialTransport(str(path))
    assert not file.read_bytes()


def test_no_permission_gives_the_command_to_run() -> None:
    sentence = opening_error_message("/dev/ttyACM0", PermissionError(errno.EACCES, "Permission denied"))
    assert "sudo usermod -aG dialout $USER" in sentence
    assert "log out" in sentence


def test_a_port_that_vanishes_is_noticed_by_writing_and_by_listening(board: VirtualBoard) -> None:
    writer = SerialTransport(board.port)
    writer.write(REST)
    board.unplug()
    with pytest.raises(PortError, match="vanished"):
        writer.write(REST)
    with pytest.raises(PortError, match="vanished"):
        writer.read()
    writer.close()
    writer.close()


def test_a_closed_port_refuses_with_a_sentence(board: VirtualBoard) -> None:
    transport = SerialTransport(board.port)
    transport.close()
    with pytest.raises(PortError):
        transport.write(REST)


def test_a_board_that_takes_no_data_is_noticed() -> None:
    master, slave = os.openpty()
    tty.setraw(slave)
    with SerialTransport(os.ttyname(slave)) as transport, pytest.raises(PortError, match="took no data"):
        transport.write(bytes(1_000_000))
    os.close(slave)
    os.close(master)


def test_a_pause_of_this_process_after_a_write_is_no_board_that_takes_nothing(
    board: VirtualBoard, monkeypatch: pytest.MonkeyPatch
) -> None:
    late = iter(range(10))
    monkeypatch.setattr(serial.serialutil.Timeout, "TIME", lambda: float(next(late)))  # a second a look
    with SerialTransport(board.port) as transport:
        transport.write(bytes([255, 93, 121, 134]))
        assert board.wait_for(lambda b: b.servo_bytes == (93, 121, 134))


@dataclass
class Port:
    """What pyserial tells of a port."""

    device: str
    vid: int | None = None
    pid: int | None = None
    manufacturer: str | None = None
    description: str = "n/a"


UNO = Port("/dev/ttyACM0", 0x2341, 0x0043, "Arduino (www.arduino.cc)")
OTHER_UNO = Port("/dev/ttyACM1", 0x2A03, 0x0043)
CLONE = Port("/dev/ttyUSB0", 0x1A86, 0x7523, None, "USB Serial")
BUILT_IN = Port("/dev/ttyS0")


def test_a_port_that_is_named_wins() -> None:
    assert find_port("/dev/ttyS9", ports=[UNO, OTHER_UNO]) == "/dev/ttyS9"


def test_the_only_board_is_found_by_usb_id_or_manufacturer(tmp_path: Path) -> None:
    assert find_port(ports=[BUILT_IN, CLONE, OTHER_UNO], by_id=tmp_path) == "/dev/ttyACM1"
    by_name = Port("/dev/ttyACM4", 1, 2, "Arduino LLC")
    assert find_port(ports=[BUILT_IN, by_name], by_id=tmp_path) == "/dev/ttyACM4"


def test_a_stable_link_is_preferred(tmp_path: Path) -> None:
    link = tmp_path / "usb-Arduino__www.arduino.cc__0043_123-if00"
    link.symlink_to("/dev/ttyACM0")
    (tmp_path / "usb-Some_modem-if00").symlink_to("/dev/ttyACM9")
    assert find_port(ports=[UNO, BUILT_IN], by_id=tmp_path) == str(link)


def test_several_boards_are_listed_and_refused(tmp_path: Path) -> None:
    with pytest.raises(
        PortError, match=r"several boards found \(/dev/ttyACM0, /dev/ttyACM1\); .*parameter port"
    ):
        find_port(ports=[OTHER_UNO, UNO], by_id=tmp_path)


def test_a_clone_is_never_chosen_unasked(tmp_path: Path) -> None:
    with pytest.raises(PortError, match=r"/dev/ttyUSB0 \(USB Serial\) may be one"):
        find_port(ports=[CLONE, BUILT_IN], by_id=tmp_path)


def test_no_board_is_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(
        PortError, match=r"no board found \(serial ports found: /dev/ttyS0\); plug the board in"
    ):
        find_port(ports=[BUILT_IN], by_id=tmp_path / "absent")


def test_a_board_that_comes_back_under_another_number_is_found_again(tmp_path: Path) -> None:
    old, new, by_id = tmp_path / "ttyACM0", tmp_path / "ttyACM1", tmp_path / "by-id"
    by_id.mkdir()
    link = by_id / "usb-Arduino-if00"
    old.write_text("")
    link.symlink_to(old)
    stable = stable_name(str(old), by_id)
    assert stable == str(link)
    assert find_same_device(str(old), stable) == str(link)
    old.rename(new)
    link.unlink()
    with pytest.raises(PortError, match=r"usb-Arduino-if00 is not plugged in; plug it in, or for another"):
        find_same_device(str(old), stable)
    old.write_text("")  # another device has the old number now
    with pytest.raises(PortError, match=r"ttyACM0 may be another device by now; plug it in"):
        find_same_device(str(old), stable)
    with pytest.raises(PortError, match="is not plugged in"):
        find_same_device("", stable)  # nor is a board taken that a search would find
    link.symlink_to(new)
    assert find_same_device(str(old), stable) == find_same_device("", stable) == str(link)
    assert find_same_device(str(old), "") == str(old)
    assert stable_name("/dev/ttyS7", by_id) == stable_name("/dev/ttyS7", tmp_path / "absent") == ""


def test_who_else_may_hold_the_port_is_named() -> None:
    assert "ModemManager" in opening_error_message("/dev/ttyACM0", OSError(errno.EBUSY, "busy"))
    assert "99-tripod.rules" in opening_error_message("/dev/ttyACM0", PermissionError(errno.EACCES, "no"))
