"""Driver and virtual board in the extended protocol: detection, ranges, e-stop, resets, telemetry, end."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from board_driving import TestClock, Wait, flags, robot, run, take_over

from servo_bridge import PortError
from servo_bridge.driver import (
    ServoDriver,
    angle_to_width,
    byte_to_angle,
    byte_to_width,
    width_limits,
    width_to_angle,
)
from servo_bridge.emulator import VirtualBoard
from servo_bridge.protocols import FIRMWARE_VERSION, BoardFlags, set_widths
from softsim_core.base import SceneError
from softsim_core.scene import ServoCalibration


@pytest.fixture
def board(tmp_path: Path) -> Iterator[VirtualBoard]:
    with VirtualBoard(link=tmp_path / "board", protocol="extended") as virtual:
        yield virtual


@pytest.fixture
def clock() -> TestClock:
    return TestClock()


@pytest.fixture
def driver(board: VirtualBoard, clock: TestClock, wait_until: Wait) -> Iterator[ServoDriver]:
    made = ServoDriver(robot(), clock=clock, wait=clock.wait)
    made.connect(board.port, quiet_s=2.5)
    made.start()
    assert wait_until(lambda: made.link_state == "extended")
    yield made
    made.disconnect()


def test_a_banner_ends_the_quiet_time_and_ranges_go_before_poses(
    driver: ServoDriver, clock: TestClock, board: VirtualBoard, wait_until: Wait
) -> None:
    assert board.received == 0
    assert driver.tick() is None  # SET_LIMITS
    assert board.wait_for(lambda b: b.model.limits_us != ())
    assert board.accepted == 0
    take_over(driver)
    assert driver.sent_bytes == (150, 150, 150)
    assert board.wait_for(lambda b: b.servo_bytes == (150, 150, 150))
    assert board.model.limits_us == ((1163, 2400),) * 3
    assert wait_until(lambda: BoardFlags.LIMITS_SET | BoardFlags.ACTIVE in flags(driver))
    assert driver.link is not None
    assert driver.link.board.banner is not None
    assert (driver.link.board.banner.major, driver.link.board.banner.minor) == FIRMWARE_VERSION


def test_poses_are_finer_than_a_degree_and_acknowledged(
    driver: ServoDriver, clock: TestClock, board: VirtualBoard, wait_until: Wait
) -> None:
    driver.start()
    take_over(driver)
    driver.command([-1.4965, -1.046667, -0.785])
    run(driver, clock, 0.4)
    widths = tuple(angle_to_width(angle, servo) for angle, servo in zip(
        [-1.4965, -1.046667, -0.785], driver.servos, strict=True))  # fmt: skip
    assert driver.link is not None
    assert wait_until(lambda: driver.link.board.telemetry.widths_us == widths)  # type: ignore[union-attr]
    assert driver.applied_angles() == pytest.approx([-1.4965, -1.046667, -0.785], abs=math.radians(0.05))
    assert wait_until(lambda: driver.link.board.unacknowledged == 0)  # type: ignore[union-attr]
    assert driver.link.board.frames_dropped == 0
    assert board.dropped == 0


def test_the_e_stop_is_said_to_the_board(
    driver: ServoDriver, clock: TestClock, board: VirtualBoard, wait_until: Wait
) -> None:
    take_over(driver)
    driver.command([-1.0] * 3)
    run(driver, clock, 0.2)
    pose = driver.applied_angles()
    driver.motion.e_stop.latch()
    driver.command([-2.0] * 3)
    run(driver, clock, 0.2)
    assert driver.applied_angles() == pose
    assert wait_until(lambda: BoardFlags.HOLD in flags(driver))
    driver.disconnect(relax=True)
    assert board.wait_for(lambda b: not b.is_open)
    assert not board.model.motion.relaxed


def test_pulses_are_switched_off_at_the_end_at_rest(
    driver: ServoDriver, clock: TestClock, board: VirtualBoard
) -> None:
    take_over(driver)
    driver.command([-1.0] * 3)
    run(driver, clock, 0.2)
    assert driver.settle()
    driver.disconnect(relax=True)
    assert board.wait_for(lambda b: b.model.motion.relaxed)
    assert board.servo_bytes == (150, 150, 150)


def test_a_board_that_restarts_is_told_its_ranges_and_goes_on_where_it_stood(
    driver: ServoDriver, clock: TestClock, board: VirtualBoard, wait_until: Wait
) -> None:
    take_over(driver)
    driver.command([-1.0] * 3)
    run(driver, clock, 0.3)
    pose = driver.applied_angles()
    link = driver.link
    assert link is not None
    assert wait_until(lambda: board.servo_bytes == (122,) * 3 and board.model.motion.arrived)
    banners = link.board.banners
    board.restart(cause=8)
    assert wait_until(lambda: link.board.banners == banners + 1)
    assert wait_until(lambda: driver.link_state == "extended")
    assert wait_until(lambda: BoardFlags.WATCHDOG in flags(driver))
    assert driver.tick() is None
    take_over(driver)
    assert driver.sent_bytes == (122, 122, 122)
    assert driver.applied_angles() == pytest.approx(pose)
    assert driver.counts.restarts == 2
    assert board.wait_for(lambda b: b.model.limits_us != ())


def test_a_board_that_kept_its_pose_gives_the_first_one(
    board: VirtualBoard, clock: TestClock, wait_until: Wait
) -> None:
    driver = ServoDriver(robot(), clock=clock, wait=clock.wait)
    driver.connect(board.port, quiet_s=2.5)
    assert wait_until(lambda: driver.link_state == "extended")
    with board._changed:  # a board whose reset line is cut, and which somebody moved
        board.model.feed(set_widths(0, [1500, 1600, 1700]), time.monotonic())
    assert wait_until(lambda: BoardFlags.ACTIVE in flags(driver))
    driver.start()
    take_over(driver)
    assert board.wait_for(lambda b: b.accepted == 2)
    assert board.widths_us == (1500.0, 1600.0, 1700.0)
    driver.disconnect()


def test_telemetry_that_stops_is_a_lost_board(
    driver: ServoDriver, clock: TestClock, board: VirtualBoard, wait_until: Wait
) -> None:
    driver.tick()
    board.model.silent = True

    def lost() -> bool:
        clock.wait(1.0)
        try:
            driver.listen()
        except PortError as error:
            return "no telemetry" in str(error)
        return False

    assert wait_until(lost)


def test_a_damaged_line_is_rejected_and_reported(
    driver: ServoDriver, clock: TestClock, board: VirtualBoard, wait_until: Wait
) -> None:
    take_over(driver)
    assert driver._transport is not None
    driver._transport.write(b"\xfe\x81\x85\x80\xfe\x9f")
    driver.tick()
    assert driver.link is not None
    assert wait_until(lambda: driver.link.board.telemetry.rejects >= 1)  # type: ignore[union-attr]


@pytest.mark.parametrize(("sign", "zero"), [(1, 179), (-1, 61)])
def test_widths_of_nominal_angles_are_those_of_the_bytes(sign: int, zero: int) -> None:
    servo = ServoCalibration(joint="j", sign=sign, zero_byte=zero, trim_deg=0.3)  # type: ignore[arg-type]
    for byte in range(60, 181):
        angle = byte_to_angle(byte, servo)
        assert abs(angle_to_width(angle, servo) - byte_to_width(byte)) <= 0.5 + 1e-6
        assert width_to_angle(byte_to_width(byte), servo) == pytest.approx(angle)
    for angle in (-1e308, -1e9, -3.0, 0.0, 3.0, 1e9, 1e308):
        low, rest, high = width_limits(servo)
        assert low <= rest <= high
        assert low <= angle_to_width(angle, servo) <= high


def test_other_numbers_of_servos_stay_with_the_legacy_protocol() -> None:
    assert ServoDriver(robot(2)).protocol == "legacy"
    with pytest.raises(SceneError, match="has 2 servos, the extended protocol 3"):
        ServoDriver(robot(2), protocol="extended")
    with pytest.raises(SceneError, match=r"allows bytes 60\.\.180, not 0\.\.180"):
        ServoDriver(robot(byte_min=0), protocol="ascii_imu")
    assert ServoDriver(robot(), protocol="ascii_imu").baud_rate == 57600
