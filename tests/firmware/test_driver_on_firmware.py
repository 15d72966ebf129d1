"""From a command to pulse widths in simulated time: driver, line, firmware in the emulator, on one clock."""

from __future__ import annotations

import random
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest
from firmware_build import build, build_boot_loader
from lock_step import QUIET_S, REST, TOLERANCE_US, LockStep, tripod

from servo_bridge import PortError
from servo_bridge.driver import byte_to_width
from servo_bridge.emulator import EmulatedBoard
from servo_bridge.protocols import ExtendedProtocol
from softsim_core import load_scene

MakeBoard = Callable[..., EmulatedBoard]

SLEW_US = 62.5
"""Largest change of a width in a frame in [us]: the firmware's limit, and what two edges may be off."""

POSE = (90, 120, 165)
WIDE = """extends: tripod.yaml
joints:
  - {name: servo_0, limits: &all {lower: -2.1, upper: 0.02, speed: 20.0, acceleration: 1000.0}}
  - {name: servo_1, limits: *all}
  - {name: servo_2, limits: *all}
"""


def test_every_byte_reaches_every_pin(board: EmulatedBoard, tmp_path: Path) -> None:
    robot = tmp_path / "wide.yaml"
    robot.write_text(WIDE.replace("tripod.yaml", str(tripod().source)))
    driven = LockStep(board, robot=load_scene(robot))
    driven.connect()
    for first in range(60, 181):
        driven.drive_to(first, 60 + (first - 60 + 40) % 121, 60 + (first - 60 + 80) % 121)
    assert driven.largest_step_us() <= SLEW_US
    driven.close()


def test_a_silent_board_is_written_to_after_the_quiet_time(make_board: MakeBoard) -> None:
    driven = LockStep(make_board(build("-DLEGACY_ONLY")))
    driven.connect()
    opened = driven.board.time_s
    assert driven.drive_until(lambda: driven.received > 0, POSE)
    assert driven.board.time_s - opened == pytest.approx(QUIET_S, abs=2 * driven.driver.period)
    assert driven.driver.link_state == "legacy"
    driven.drive_to(*POSE)
    driven.close()


def test_a_board_that_starts_is_written_to_once_it_has_spoken(make_board: MakeBoard) -> None:
    driven = LockStep(make_board(bootloader=build_boot_loader()))
    before = bytes(driven.board.processor.flash)
    driven.connect()
    opened = driven.board.time_s
    assert driven.drive_until(lambda: driven.received > 0, POSE)
    assert driven.board.time_s - opened == pytest.approx(1.45, abs=0.1)  # the boot loader's 1.4 s
    driven.drive_to(*POSE)
    assert bytes(driven.board.processor.flash) == before
    driven.close()


@pytest.mark.parametrize("plain", [False, True])
def test_a_board_lost_in_its_boot_loader_is_driven_again_where_it_speaks(
    make_board: MakeBoard, plain: bool
) -> None:
    driven = LockStep(make_board(build("-DLEGACY_ONLY") if plain else None, build_boot_loader()))
    driven.connect()
    driven.drive(0.5, POSE)
    driven.unplug()
    assert driven.driver.met is None
    assert not driven.driver.moved
    driven.plugged = True
    driven.connect(again=True, silent_allowed=False)
    if plain:
        with pytest.raises(PortError, match="unknown; check it, then cleanup and configure"):
            driven.drive(10.0, POSE)
        assert driven.received == 0
    else:
        driven.drive_to(*POSE)
    driven.close()


def test_a_bridge_that_is_gone_leaves_a_robot_that_holds_and_then_rests(board: EmulatedBoard) -> None:
    driven = LockStep(board)
    driven.connect()
    driven.drive_to(90, 110, 120)
    board.clear()
    gone = board.time_s
    while not driven.at(*REST):
        assert board.time_s - gone < 5.0
        driven.run(0.02)
    assert board.time_s - gone > 2.0
    for channel, held in enumerate((90, 110, 120)):
        mine = [each for each in board.pulses if each.channel == channel]
        still = [each for each in mine if each.start_s < gone + 1.9]
        assert all(abs(each.width_us - byte_to_width(held)) < TOLERANCE_US for each in still)
        creep = [abs(later.width_us - earlier.width_us) for earlier, later in pairwise(mine)]
        assert max(creep) < 12.0  # 10 us per frame: 48 degrees per second
    driven.close()


def test_unplugged_at_any_time_it_comes_back_slowly(board: EmulatedBoard) -> None:
    choose = random.Random(4)
    driven = LockStep(board)
    driven.connect()
    driven.drive_to(*POSE)
    for seconds in [0.0, 0.02, 0.06, 0.1, *(choose.uniform(0.0, 1.0) for _ in range(10))]:
        driven.drive(seconds, [choose.randint(60, 180) for _ in range(3)])
        assert driven.largest_step_us() <= SLEW_US
        driven.unplug()
        with pytest.raises(PortError, match="vanished"):
            driven.drive(0.2, POSE)
        driven.run(0.5)
        board.clear()
        driven.plugged = True
        driven.connect(again=True, silent_allowed=False)
    driven.drive_to(*POSE)
    assert driven.largest_step_us() <= SLEW_US
    driven.close()


class NoisyLine:
    """Turns every bit over with a probability; counts the bits that it did."""

    def __init__(self, rate: float) -> None:
        self.flipped = 0
        self._rate, self._random = rate, random.Random(8)

    def __call__(self, data: bytes) -> bytes:
        return bytes(map(self._pass, data))

    def _pass(self, value: int) -> int:
        mask = sum((self._random.random() < self._rate) << bit for bit in range(8))
        self.flipped += mask.bit_count()
        return value ^ mask


def test_a_noisy_line_never_makes_a_servo_fast(board: EmulatedBoard) -> None:
    noise = NoisyLine(1e-3)
    driven = LockStep(board, line=noise)
    driven.connect()
    for pose in [(90, 120, 165), (165, 90, 120), (120, 165, 90)] * 4:
        driven.drive_to(*pose)
        driven.drive(1.0, pose)
    assert noise.flipped > 100
    assert driven.largest_step_us() <= SLEW_US
    assert min(pulse.width_us for pulse in board.pulses) > byte_to_width(60) - TOLERANCE_US
    driven.close()


@pytest.mark.parametrize("seconds", [20, pytest.param(1800, marks=pytest.mark.exhaustive)])
def test_nothing_is_lost(board: EmulatedBoard, seconds: int) -> None:
    driven = LockStep(board)
    driven.connect()
    driven.drive_to(*REST)
    board.clear()
    packets, period = driven.driver.counts.packets, driven.driver.period
    for second in range(seconds):  # to and fro, a second each way
        driven.drive(1.0, ((90,) * 3, (160,) * 3)[second % 2])
    starts = [pulse.start_s for pulse in board.pulses if pulse.channel == 0]
    assert len(starts) >= 50 * seconds - 1
    assert max(later - earlier for earlier, later in pairwise(starts)) < 0.0205  # no reset, no hang
    counts, link = driven.driver.counts, driven.driver.link
    assert link is not None
    protocol = link.board
    assert isinstance(protocol, ExtendedProtocol)
    assert protocol.telemetry is not None
    assert counts.packets - packets == round(seconds / period)
    assert (counts.refused, counts.restarts, protocol.banners) == (0, 1, 1)
    assert (
        protocol.telemetry.rejects,
        protocol.telemetry.overruns,
        protocol.values()["telemetry damaged"],
    ) == (0, 0, 0)
    assert protocol.most_unacknowledged < 10  # of 64
    assert driven.driver.takeover.count == 0
    driven.close()
