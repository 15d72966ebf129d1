"""Whenever the board is not where it was told to be, the driver says so and goes on from where it stands."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from board_driving import PERIOD, TestClock, Wait, flags, robot, run, take_over
from node_processes import spin_until

from servo_bridge import PortError
from servo_bridge.driver import STALL_S, ServoDriver, angle_to_width
from servo_bridge.emulator import VirtualBoard
from servo_bridge.protocols import (
    DEAF_PATIENCE,
    PATIENCE,
    BoardFlags,
    ExtendedProtocol,
    PoseComparison,
    Telemetry,
)
from softsim_core.physics.mechanics import JointLimits

pytestmark = pytest.mark.slow

FAR = -2.0
REST = (150, 150, 150)
SPEED = JointLimits(-2.0225, -0.0255, 3.5, 40.0)
DRIVEN = BoardFlags.LINK | BoardFlags.ACTIVE | BoardFlags.LIMITS_SET


@pytest.fixture
def board(tmp_path: Path) -> Iterator[VirtualBoard]:
    with VirtualBoard(link=tmp_path / "board", protocol="extended") as virtual:
        yield virtual


@pytest.fixture
def clock() -> TestClock:
    return TestClock()


@pytest.fixture
def driver(board: VirtualBoard, clock: TestClock, wait_until: Wait) -> Iterator[ServoDriver]:
    made = ServoDriver(robot(limits=SPEED), clock=clock, wait=clock.wait)
    made.connect(board.port, quiet_s=2.5)
    made.start()
    assert wait_until(lambda: made.link_state == "extended")
    yield made
    made.disconnect()


def drive_far(driver: ServoDriver, clock: TestClock, board: VirtualBoard) -> None:
    take_over(driver)
    for _ in range(60):
        driver.command([FAR] * 3)
        run(driver, clock, PERIOD)
    far = [angle_to_width(FAR, servo) for servo in driver.servos]
    assert spin_until(lambda: board.widths_us == tuple(far))  # it moves in its own time


def steps_deg(driver: ServoDriver, clock: TestClock, ticks: int) -> list[float]:
    """Largest change of a pose sent, tick by tick, on the way to a fresh command far away."""
    poses = [driver.applied_angles()]
    for _ in range(ticks):
        driver.command([FAR] * 3)
        clock.wait(PERIOD)
        if driver.tick() is not None:
            poses.append(driver.applied_angles())
    return [
        max(abs(math.degrees(b - a)) for a, b in zip(before, after, strict=True))
        for before, after in pairwise(poses)
    ]


def test_the_ranges_are_sent_until_they_are_acknowledged(
    driver: ServoDriver, clock: TestClock, board: VirtualBoard
) -> None:
    board.model.deaf = True
    for _ in range(10):
        clock.wait(PERIOD)
        driver.command([FAR] * 3)
        assert driver.tick() is None
    assert driver.takeover.pending
    board.model.deaf = False
    take_over(driver)
    assert board.model.limits_us == ((1163, 2400),) * 3
    assert board.wait_for(lambda b: b.accepted == 1)


def test_a_stalled_bridge_goes_on_from_where_the_board_went_by_itself(
    driver: ServoDriver, clock: TestClock, board: VirtualBoard, wait_until: Wait
) -> None:
    drive_far(driver, clock, board)
    assert wait_until(lambda: BoardFlags.HOMING in flags(driver))
    assert wait_until(lambda: (board.widths_us or (0.0,))[0] > 1500.0)  # half-way to rest
    clock.wait(5.0)
    driver.command([FAR] * 3)
    accepted = board.accepted
    assert driver.tick() is None  # first the board is asked, which also stops it
    assert board.accepted == accepted
    assert "the bridge was stalled for 5.0 s" in driver.takeover.news[0]
    take_over(driver)
    assert driver.sent_bytes is not None
    assert 90 < driver.sent_bytes[0] < 150
    assert "deg away from its commands" in driver.takeover.news[1]
    moves = steps_deg(driver, clock, 60)
    assert 3.0 < max(moves) <= math.degrees(3.5) * PERIOD + 0.2  # widths are whole us, 0.1 deg
    changes = [abs(after - before) for before, after in pairwise([0.0, *moves])]
    assert max(changes) <= math.degrees(40.0) * PERIOD**2 + 0.4
    assert board.wait_for(lambda b: b.servo_bytes == (64, 64, 64))


def test_a_bridge_started_anew_goes_on_from_where_the_servos_were_when_it_was_killed(
    driver: ServoDriver, clock: TestClock, board: VirtualBoard, wait_until: Wait
) -> None:
    drive_far(driver, clock, board)
    driver.disconnect()  # and not to rest before
    anew = ServoDriver(robot(limits=SPEED), clock=clock, wait=clock.wait)
    anew.connect(board.port, quiet_s=2.5)  # resets the board
    assert wait_until(lambda: anew.link_state == "extended")
    anew.start()
    take_over(anew)
    assert anew.applied_angles() == pytest.approx([FAR] * 3, abs=math.radians(0.2))
    poses = [anew.applied_angles()[0]]
    for _ in range(60):
        anew.command([-0.5] * 3)
        run(anew, clock, PERIOD)
        poses.append(anew.applied_angles()[0])
    speeds = [0.0, *(math.degrees(after - before) / PERIOD for before, after in pairwise(poses))]
    assert 150.0 < max(speeds) <= math.degrees(3.5) + 10.0  # widths are whole us, 0.1 deg
    assert max(abs(b - a) for a, b in pairwise(speeds)) <= math.degrees(40.0) * PERIOD + 20.0
    anew.disconnect()


def test_a_dead_line_to_the_board_is_noticed_although_telemetry_lives(
    driver: ServoDriver, clock: TestClock, board: VirtualBoard, wait_until: Wait
) -> None:
    drive_far(driver, clock, board)

    def noticed() -> bool:
        clock.wait(0.004)
        driver.tick()
        return driver.takeover.pending

    assert wait_until(lambda: not noticed() and flags(driver) == DRIVEN)
    board.model.deaf = True
    assert wait_until(noticed)
    words = ("acknowledges no command", "holds by itself")  # whichever its telemetry shows first
    assert driver.takeover.reason.startswith(tuple(f"the board {each}" for each in words))
    assert wait_until(lambda: noticed() and BoardFlags.HOMING in flags(driver))
    assert wait_until(lambda: noticed() and (board.widths_us or (0.0,))[0] > 1400.0)
    board.model.deaf = False
    assert wait_until(lambda: not noticed())
    assert driver.link is not None
    at_board = lambda: driver.link.board.telemetry.widths_us == board.widths_us  # noqa: E731
    assert wait_until(at_board)
    assert driver.applied_angles() == pytest.approx(driver.link.board.pose(), abs=math.radians(1.0))
    assert driver.counts.restarts == 1  # it never started anew: same port, same board


def test_after_an_e_stop_it_goes_on_from_where_the_board_stopped(
    driver: ServoDriver, clock: TestClock, board: VirtualBoard, wait_until: Wait
) -> None:
    take_over(driver)
    for _ in range(20):
        driver.command([FAR] * 3)
        run(driver, clock, PERIOD)  # in no time of the board, which lags behind
    driver.motion.e_stop.latch()
    run(driver, clock, PERIOD)
    assert wait_until(lambda: BoardFlags.HOLD in flags(driver))
    stopped = board.widths_us
    assert stopped is not None
    driver.motion.e_stop.clear()
    take_over(driver)
    assert driver.link is not None
    assert driver.applied_angles() == pytest.approx(driver.link.board.pose(), abs=math.radians(0.2))
    accepted = board.accepted
    sent = {driver.applied_angles()}
    for _ in range(200):  # four seconds without a command: not to rest, either
        clock.wait(PERIOD)
        driver.tick()
        sent.add(driver.applied_angles())
    assert len(sent) == 1
    assert board.wait_for(lambda b: b.accepted > accepted)
    assert board.widths_us == pytest.approx(stopped, abs=1.0)


def test_standing_by_it_still_tells_the_board_to_hold(
    driver: ServoDriver, clock: TestClock, board: VirtualBoard, wait_until: Wait
) -> None:
    drive_far(driver, clock, board)
    assert wait_until(lambda: BoardFlags.HOMING in flags(driver))  # it goes to rest by itself
    driver.stand_by()
    driver.motion.e_stop.latch()
    clock.wait(PERIOD)
    driver.tick()
    assert wait_until(lambda: BoardFlags.HOLD in flags(driver))
    assert BoardFlags.HOMING not in flags(driver)


def test_no_pose_is_sent_faster_than_the_board_moves() -> None:
    fast = JointLimits(-2.0225, -0.0255, 50.0, 1e9)
    driver = ServoDriver(robot(limits=fast))
    driver.motion.top_speed = ExtendedProtocol.top_speed
    driver.motion.start(0.0)
    driver.motion.command([FAR] * 3, 0.0)
    path = [driver.motion.step(tick * PERIOD)[0] for tick in range(20)]
    assert max(abs(b - a) for a, b in pairwise(path)) == pytest.approx(math.radians(61.0 / 1856 * 180))


@pytest.mark.parametrize(
    ("flags", "widths", "words"),
    [
        (DRIVEN, (1500, 1500, 1500), ""),
        (DRIVEN, (1300, 1510, 1500), ""),  # on the way
        (DRIVEN & ~BoardFlags.ACTIVE, (0, 0, 0), "has no pulses"),
        (DRIVEN | BoardFlags.HOMING, (1500, 1500, 1500), "moves to its rest pose by itself"),
        (DRIVEN | BoardFlags.HOLD, (1500, 1500, 1500), "holds by itself"),
        (DRIVEN & ~BoardFlags.LIMITS_SET, (1500, 1500, 1500), "has forgotten its servos' ranges"),
        (DRIVEN, (1500, 1540, 1500), "is at 1500 1540 1500 us"),
    ],
)
def test_telemetry_that_contradicts_twice_is_a_deviation(
    flags: BoardFlags, widths: tuple[int, ...], words: str
) -> None:
    following = PoseComparison()
    for seq, width in enumerate((1200, 1400, 1500), start=1):
        following.record_frame()
        following.record_pose(seq, (width, 1500, 1500))
    for _ in range(PATIENCE):
        assert following.deviation == ""
        following.compare(Telemetry(3, flags, widths, 0, 0))
    assert following.deviation.startswith(words)
    assert bool(following.deviation) == bool(words)
    following.begin()
    assert following.deviation == ""


def test_a_board_that_acknowledges_nothing_is_deaf() -> None:
    following = PoseComparison()
    for seq in range(1, DEAF_PATIENCE + 2):
        assert following.deviation == ""
        following.record_pose(seq, (1500,) * 3)
        following.record_frame()
        following.compare(Telemetry(0, DRIVEN, (1500,) * 3, 0, 0))
    assert following.deviation.startswith("acknowledges no command")


def test_a_board_that_acknowledges_now_and_then_is_not_deaf() -> None:
    following, last = PoseComparison(), 0
    for seq in range(1, 60):
        following.record_pose(seq, (1500,) * 3)
        following.record_frame()
        if seq % (DEAF_PATIENCE - 1) == 0:
            last = seq
        following.compare(Telemetry(last, DRIVEN, (1500,) * 3, 0, 0))
        assert following.deviation == ""
    for _ in range(DEAF_PATIENCE + 2):  # nothing is sent any more: nothing can be acknowledged
        following.compare(Telemetry(last, DRIVEN, (1500,) * 3, 0, 0))
    assert following.deviation == ""


def test_a_stall_shorter_than_a_board_s_patience_changes_nothing(
    driver: ServoDriver, clock: TestClock, board: VirtualBoard
) -> None:
    take_over(driver)
    run(driver, clock, 3 * PERIOD)
    clock.wait(STALL_S - 0.01)
    try:
        assert driver.tick() is not None
    except PortError:
        pytest.fail("telemetry within the wait counts")
    assert driver.takeover.count == 0
