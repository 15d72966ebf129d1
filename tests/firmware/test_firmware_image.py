"""The committed image is what source and flags give; its build switches work; broken images are refused."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import pytest
from firmware_build import FIRMWARE, build, compiler_version, missing
from firmware_line import TOLERANCE_US, ideal, legacy

from servo_bridge.emulator import EmulatedBoard, EmulatorError, read_image
from servo_bridge.protocols import frames


def recorded() -> tuple[dict[str, str], str]:
    """Checksums by file name, and the compiler, of the committed image."""
    lines = (FIRMWARE / "tripod.sha256").read_text().splitlines()
    sums = {line.split()[1]: line.split()[0] for line in lines if not line.startswith("#")}
    return sums, next(line.lstrip("# ") for line in lines if line.startswith("#"))


def test_the_checksums_are_those_of_the_files() -> None:
    sums, _ = recorded()
    assert set(sums) == {"tripod.c", "imu.h", "Makefile", "tripod.hex"}
    for name, checksum in sums.items():
        seen = hashlib.sha256((FIRMWARE / name).read_bytes()).hexdigest()
        assert seen == checksum, f"{name} changed: run make all checksum in servo_bridge/firmware"


def test_the_image_is_built_byte_for_byte() -> None:
    _, compiler = recorded()
    if compiler_version() != compiler:
        pytest.skip(f"the image was built with {compiler}, here is {compiler_version()}")
    assert build().read_bytes() == (FIRMWARE / "tripod.hex").read_bytes()


def test_a_board_without_frames_and_telemetry(make_board: Callable[..., EmulatedBoard]) -> None:
    board = make_board(build("-DLEGACY_ONLY"))
    board.run(0.1)
    board.feed(frames.set_widths(1, [1500] * 3))
    board.run(0.1)
    assert board.widths_us() is None
    board.feed(legacy(90, 120, 150))
    board.run(10.0)
    assert board.transmitted == b""
    assert board.widths_us() == pytest.approx(ideal(90, 120, 150), abs=TOLERANCE_US)  # silence never moves it


def test_a_board_without_watchdog(make_board: Callable[..., EmulatedBoard]) -> None:
    board = make_board(build("-DNO_WDT"))
    board.run(0.1)
    place = board.processor.program_counter
    board.processor.flash[place : place + 2] = [0xFF, 0xCF]  # a jump to itself
    board.run(1.0)
    assert board.resets == 1


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "holds no bytes"),
        ("hello\n", "line 1: 'hello' is no line of an Intel hex file"),
        (":0100000001FD\n", "checksum is wrong"),
        (":01000000", "is no line"),
    ],
)
def test_a_broken_image_is_refused(tmp_path: Path, text: str, sentence: str) -> None:
    file = tmp_path / "broken.hex"
    file.write_text(text)
    with pytest.raises(EmulatorError, match=sentence):
        read_image(file)


def test_a_missing_image_is_refused(tmp_path: Path) -> None:
    with pytest.raises(EmulatorError, match=r"cannot be read .* give an Intel hex file"):
        read_image(tmp_path / "none.hex")


def test_an_image_beyond_the_flash_is_refused(emulator: None, tmp_path: Path) -> None:
    file = tmp_path / "far.hex"
    file.write_text(":017FFF00FF82\n:020000021000EC\n:01000000FF00\n:00000001FF\n")
    with pytest.raises(EmulatorError, match="do not fit"):
        EmulatedBoard(file)


def test_erased_flash_is_an_error_not_an_endless_loop(board: EmulatedBoard) -> None:
    board.processor.flash[:] = [0xFF] * len(board.processor.flash)
    with pytest.raises(EmulatorError, match="the emulated processor stopped at"):
        board.run(5.0)


def test_the_skip_fails_where_the_emulator_is_required(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("REQUIRE_SIMAVR", "1")
    with pytest.raises(pytest.fail.Exception, match="gone"):
        missing("gone")
