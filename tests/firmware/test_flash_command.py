"""`softsim flash`: what it says, what it refuses, and avrdude against the real boot loader, emulated."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from firmware_build import build_boot_loader, missing

from servo_bridge.driver import SerialTransport
from servo_bridge.emulator import FIRMWARE, EmulatedBoardPty, read_image
from servo_bridge.protocols import FrameParser, FrameType
from softsim_ros.cli import main
from softsim_ros.cli.board import flash_command, is_as_recorded


@pytest.fixture
def avrdude() -> None:
    if shutil.which("avrdude") is None:
        missing("avrdude is missing (apt-get install avrdude)")


def test_a_dry_run_names_file_port_and_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["flash", "--dry-run", "--port", "/dev/ttyACM7"]) == 0
    shown = capsys.readouterr().out
    assert str(FIRMWARE) in shown
    assert "avrdude -c arduino -p m328p -b115200 -P /dev/ttyACM7 -U flash:w:" in shown
    assert "nothing was done" in shown


def test_it_asks_and_does_nothing_without_an_answer(
    avrdude: None, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdin.isatty", lambda: False, raising=False)
    assert main(["flash", "--port", "/dev/ttyACM7"]) == 1
    assert "nothing was done; answer yes, or give --yes" in capsys.readouterr().err


def test_a_changed_image_is_refused(tmp_path: Path) -> None:
    for name in ("tripod.hex", "tripod.sha256"):
        shutil.copy(FIRMWARE.with_name(name), tmp_path)
    copy = tmp_path / "tripod.hex"
    assert is_as_recorded(copy)
    copy.write_bytes(copy.read_bytes().replace(b"0C", b"0D", 1))
    assert not is_as_recorded(copy)


def test_a_file_that_is_no_firmware_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "text.hex"
    file.write_text("hello")
    assert main(["flash", "--hex", str(file), "--port", "/dev/ttyACM7", "--dry-run"]) == 1
    assert "is no line of an Intel hex file" in capsys.readouterr().err


def test_an_old_nano_has_a_slower_boot_loader() -> None:
    assert "-b57600" in flash_command("/dev/ttyUSB0", FIRMWARE, 57600)


def read_all(port: SerialTransport) -> bytes:
    """What the board says in the boot loader's window and the moment after it."""
    data = b""
    while len(data) < 64:
        data += port.read()
    return data


@pytest.mark.slow
def test_the_firmware_is_written_through_the_boot_loader(
    emulator: None, avrdude: None, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    address, wanted = read_image(FIRMWARE)
    blank = tmp_path / "blank.hex"
    blank.write_text(":02000000FFCF30\n:00000001FF\n")  # a jump to itself: a board that says nothing
    with EmulatedBoardPty(blank, build_boot_loader(), tmp_path / "board") as board:
        with SerialTransport(board.port):  # a bridge that was left running
            assert main(["flash", "--yes", "--port", board.port]) == 1
        assert "in use by another program" in capfd.readouterr().err
        assert board.wait_for(lambda board: not board.is_open)
        assert main(["flash", "--yes", "--port", board.port]) == 0
        assert board.read_flash(address, len(wanted)) == wanted
        assert board.wait_for(lambda board: not board.is_open)
        with SerialTransport(board.port) as port:
            assert FrameParser().feed(read_all(port))[0].kind is FrameType.BANNER
