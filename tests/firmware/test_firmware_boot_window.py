"""The second after a reset in which the Uno's boot loader listens: what harms the firmware, and what not."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from firmware_build import build_boot_loader
from firmware_line import TOLERANCE_US, ideal, legacy

from servo_bridge.emulator import EmulatedBoard, EmulatorError
from servo_bridge.protocols import BOOT_LOADER_BYTE, avoid_byte_100, frames
from softsim_core.scene import load_scene

MakeBoard = Callable[..., EmulatedBoard]


@pytest.fixture(scope="module")
def boot_loader(emulator: None) -> Path:
    """The boot loader built from Debian's source."""
    return build_boot_loader()


def reset_while_streaming(board: EmulatedBoard, data: bytes, repeat: int = 40) -> bool:
    """Reset the board, then send; whether the flash is as it was afterwards."""
    before = bytes(board.processor.flash)
    board.reset()
    board.run(0.4)
    board.feed(data * repeat)
    try:
        board.run(0.1 + len(data) * repeat * 1389 / 16e6)
    except EmulatorError:  # it ran into the page that was erased
        return False
    return bytes(board.processor.flash) == before


def test_the_firmware_starts_when_the_boot_loader_is_done(make_board: MakeBoard, boot_loader: Path) -> None:
    board = make_board(bootloader=boot_loader)
    board.run(0.05)
    assert board.transmitted  # no window after a power-on
    board.clear()
    board.reset()
    start = board.time_s
    assert board.run_until(lambda board: bool(board.transmitted), 3.0)
    assert 1.3 < board.time_s - start < 1.5
    board.feed(legacy(90, 120, 150))
    board.run(0.1)
    assert board.widths_us() == pytest.approx(ideal(90, 120, 150), abs=TOLERANCE_US)


def test_a_watchdog_reset_is_told_although_the_boot_loader_forgets_it(
    make_board: MakeBoard, boot_loader: Path
) -> None:
    board = make_board(bootloader=boot_loader)
    board.run(0.1)
    place = board.processor.program_counter
    saved = bytes(board.processor.flash[place : place + 2])
    board.processor.flash[place : place + 2] = [0xFF, 0xCF]  # a jump to itself
    board.clear()
    assert board.run_until(lambda board: board.resets == 2, 1.0)
    board.processor.flash[place : place + 2] = list(saved)
    board.run(2.0)
    said = frames.FrameParser().feed(board.transmitted)
    banners = [frames.read_banner(frame) for frame in said if frame.kind is frames.FrameType.BANNER]
    assert [banner.reset_cause for banner in banners] == [8]


def test_a_byte_100_that_comes_first_erases_the_firmware(make_board: MakeBoard, boot_loader: Path) -> None:
    """The hazard is real: without it the tests below would show nothing."""
    stream = legacy(100, 100, 100)
    assert not reset_while_streaming(make_board(bootloader=boot_loader), stream[1:] + stream[:1])


@pytest.mark.parametrize(
    "values",
    [
        sorted({60, 80, 99, 100, 101, 117, 180, *random.Random(5).sample(range(60, 181), 8)}),
        pytest.param(range(60, 181), marks=pytest.mark.exhaustive),
    ],
    ids=["sample", "all"],
)
def test_no_other_servo_byte_does(make_board: MakeBoard, boot_loader: Path, values: Sequence[int]) -> None:
    harmful = []
    for value in values:
        board = make_board(bootloader=boot_loader)
        if not reset_while_streaming(board, bytes([value]) + legacy(value, value, value)):
            harmful.append(value)
        board.close()
    assert harmful == [BOOT_LOADER_BYTE]


@pytest.mark.slow
def test_no_packet_of_the_bridge_does_wherever_it_is_cut(make_board: MakeBoard, boot_loader: Path) -> None:
    description = load_scene("tripod").board
    assert description is not None
    servos = description.servos
    packets = [
        avoid_byte_100(legacy(*pose), servos) for pose in ((100, 99, 101), (150, 150, 150), (60, 100, 180))
    ]
    packets += [
        frames.set_widths(36, [1600, 1600, 2340]),
        frames.set_limits(36, [(544, 2091, 2400)] * 3),
        frames.slew(36, 100),
        frames.relax(36),
        frames.hold(36),
        frames.ping(36),
    ]
    board = make_board(bootloader=boot_loader)
    board.run(0.05)
    for packet in packets:
        for cut in range(len(packet)):
            assert reset_while_streaming(board, packet[cut:] + packet[:cut]), (packet.hex(" "), cut)
