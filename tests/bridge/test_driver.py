"""The driver on a virtual board and a clock of the test's own: what goes over the wire, and when."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

import pytest
from board_driving import PERIOD, TestClock

from servo_bridge import PortError
from servo_bridge.driver import ServoDriver
from servo_bridge.emulator import VirtualBoard
from servo_bridge.protocols import LegacyProtocol
from softsim_core.base import CommandError, SceneError
from softsim_core.physics.mechanics import JointLimits
from softsim_core.scene import (
    BoardDescription,
    JointDescription,
    RobotDescription,
    SceneDescription,
    ServoCalibration,
)

LIMITS = JointLimits(-2.0225, -0.0255, 3.5, acceleration=1e9)


def robot(*servos: ServoCalibration, limits: JointLimits = LIMITS) -> RobotDescription:
    """Three joints a, b, c; servos in any order."""
    joints = tuple(JointDescription(name=name, limits=limits) for name in "abc")
    chosen = servos or tuple(ServoCalibration(joint=name) for name in "abc")
    return RobotDescription(
        scene=SceneDescription(name="robot", joints=joints), board=BoardDescription(servos=chosen)
    )


@pytest.fixture
def clock() -> TestClock:
    return TestClock()


@pytest.fixture
def driver(board: VirtualBoard, clock: TestClock) -> Iterator[ServoDriver]:
    made = ServoDriver(robot(), clock=clock, wait=clock.wait)
    made.connect(board.port)
    made.start()
    assert made.tick() == (150, 150, 150)
    board.wait_for(lambda b: b.accepted == 1)
    board.clear()
    yield made
    made.disconnect()


def run(driver: ServoDriver, clock: TestClock, duration_s: float) -> list[tuple[int, ...]]:
    """Bytes of the packets of that time."""
    sent = []
    for _ in range(round(duration_s / PERIOD)):
        clock.wait(PERIOD)
        packet = driver.tick()
        assert packet is not None
        sent.append(packet)
    return sent


def test_the_wire_carries_what_was_said_to_be_sent(
    driver: ServoDriver, clock: TestClock, board: VirtualBoard
) -> None:
    driver.command([-1.4965, -1.046667, -0.785])
    sent = run(driver, clock, 0.4)
    assert sent[0] != sent[-1] == (93, 119, 134)
    assert board.wait_for(lambda b: len(b.packets) == len(sent))
    assert [packet.servo_bytes for packet in board.packets] == sent
    assert driver.applied_angles() == pytest.approx([math.radians(byte - 179) for byte in sent[-1]])


def test_the_e_stop_outlives_the_way_out(driver: ServoDriver, clock: TestClock, board: VirtualBoard) -> None:
    driver.command([-1.5] * 3)
    pose = run(driver, clock, 0.1)[-1]
    driver.motion.e_stop.latch()
    assert not driver.settle()
    assert board.wait_for(lambda b: len(b.packets) == 5)
    assert board.servo_bytes == pose


def test_settling_ends_at_rest_within_the_speed_limit(
    driver: ServoDriver, clock: TestClock, board: VirtualBoard
) -> None:
    driver.command([-2.0, -0.1, -1.0])
    before = run(driver, clock, 0.5)[-1]
    start = clock.now
    seen: list[tuple[int, ...]] = [before]
    assert driver.settle(1.5, lambda: seen.append(driver.sent_bytes or ()))
    assert clock.now - start < 0.6
    assert seen[-3:] == [(150, 150, 150)] * 3
    most = math.degrees(3.5 * PERIOD) + 1.0
    for old, new in pairwise(seen):
        assert all(abs(a - b) <= most for a, b in zip(old, new, strict=True))
    assert board.wait_for(lambda b: b.servo_bytes == (150, 150, 150))


def test_a_way_to_rest_that_takes_too_long_ends_on_the_way_within_the_limits(
    board: VirtualBoard, clock: TestClock
) -> None:
    slow = JointLimits(-2.0, -0.1, 0.5, acceleration=5.0)
    driver = ServoDriver(robot(limits=slow), clock=clock, wait=clock.wait)
    driver.connect(board.port)
    driver.start()
    for _ in range(200):
        driver.command([-2.0] * 3)
        run(driver, clock, PERIOD)
    start, seen = clock.now, [driver.motion.positions[0]]
    assert not driver.settle(0.5, lambda: seen.append(driver.motion.positions[0]))
    assert clock.now - start < 0.7  # and 0.1 s to brake
    speeds = [0.0, *((after - before) / PERIOD for before, after in pairwise(seen))]
    assert max(map(abs, speeds)) <= 0.5 + 1e-9
    assert max(abs(after - before) for before, after in pairwise([*speeds, 0.0])) <= 5.0 * PERIOD + 1e-9
    assert driver.settle(10.0)
    assert driver.sent_bytes == (150, 150, 150)
    driver.disconnect()


def test_nothing_is_written_while_the_board_starts(board: VirtualBoard, clock: TestClock) -> None:
    driver = ServoDriver(robot(), clock=clock, wait=clock.wait)
    driver.connect(board.port, quiet_s=2.5)
    driver.start()
    for _ in range(124):
        clock.wait(PERIOD)
        assert driver.tick() is None
    assert not driver.settle()  # this board was never told to move
    driver.start()
    clock.wait(2 * PERIOD)
    assert driver.tick() == (150, 150, 150)
    assert board.wait_for(lambda b: b.accepted == 1)
    assert board.received == 4
    driver.disconnect()


def test_a_lost_port_keeps_the_last_pose_sent_and_the_next_begins_there(
    driver: ServoDriver, clock: TestClock, board: VirtualBoard
) -> None:
    driver.command([-2.0] * 3)
    last = run(driver, clock, 0.1)[-1]
    board.unplug()
    clock.wait(PERIOD)
    with pytest.raises(PortError, match="vanished"):
        driver.tick()
    assert not driver.settle()
    driver.disconnect()
    board.replug()
    driver.connect(board.port)
    driver.start()
    assert set(run(driver, clock, 0.1)) == {last}


def test_refusals_change_nothing_and_are_counted(driver: ServoDriver, clock: TestClock) -> None:
    driver.command([-1.0] * 3)
    run(driver, clock, 0.3)
    for bad in ([math.nan, -1.5, -1.5], [-1.5, -math.inf, -1.5], [-1.5] * 2, [-1.5] * 4, [math.inf] * 3, []):
        with pytest.raises(CommandError, match="nothing was moved"):
            driver.command(bad)
    with pytest.raises(CommandError, match=r"joint states without c refused; they name a, b, x"):
        driver.command_named({"a": -1.5, "b": -1.5, "x": -1.5})
    for not_finite in (math.nan, math.inf, -math.inf):
        with pytest.raises(CommandError, match="for joint b refused: expected a finite number"):
            driver.command_named({"a": -1.5, "b": not_finite, "c": -1.5})
    for names, positions in (("ab", [-1.5]), ("a", [-1.5] * 2), ("x", [-1.5]), ("aa", [-1.5] * 2)):
        with pytest.raises(CommandError, match="nothing was moved"):
            driver.command_some(names, positions)
    for infinite in (math.inf, -math.inf):
        with pytest.raises(CommandError, match="for joint b is not finite"):
            driver.command_some("ab", [-1.5, infinite])
    assert set(run(driver, clock, 0.1)) == {(121, 121, 121)}
    assert driver.counts.refused == 16
    assert "joint b" in driver.counts.last_refusal


BAD_POSES = {
    "nan": (math.nan, -1.0, -1.0),
    "infinite": (-1.0, -1.0, math.inf),
    "too few": (-1.0, -1.0),
    "too many": (-1.0,) * 4,
    "none": (),
    "above the limit": (-1.0, -0.02, -1.0),  # the servo's own range ends at 0.017 rad
    "below the limit": (-2.03, -1.0, -1.0),  # and at -2.077 rad
}


@pytest.mark.parametrize("bad", BAD_POSES.values(), ids=BAD_POSES)
def test_the_last_check_before_a_packet_holds_alone(
    driver: ServoDriver,
    board: VirtualBoard,
    clock: TestClock,
    monkeypatch: pytest.MonkeyPatch,
    bad: tuple[float, ...],
) -> None:
    """A motion that is broken on purpose, whatever was commanded: no byte is written, the pose stays."""
    before = driver.motion.positions
    written: list[bytes] = []
    assert driver._transport is not None
    with monkeypatch.context() as broken:
        broken.setattr(driver._transport, "write", written.append)
        broken.setattr(driver.motion, "step", lambda now: bad)
        with pytest.raises(PortError, match="refused"):
            driver.tick()
    assert not written
    assert driver.motion.positions == before
    assert driver.sent_bytes == (150, 150, 150)
    driver.start()
    assert set(run(driver, clock, 0.1)) == {(150, 150, 150)}


def test_without_the_check_of_commands_no_packet_leaves_the_limits(
    driver: ServoDriver, board: VirtualBoard, clock: TestClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """NaN ends in the last check; what is larger than a limit becomes the limit, as in every command."""
    monkeypatch.setattr("servo_bridge.driver.driver.check_command", lambda values, joints: list(values))
    driver.command([-1.0, math.nan, -1.0])
    clock.wait(PERIOD)
    with pytest.raises(PortError, match="nan for joint b refused"):
        driver.tick()
    assert driver.tick() is None  # the port counts as failed
    assert driver.motion.positions == driver.motion.rest
    assert not board.packets
    driver.start()
    driver.command([math.inf, -math.inf, 1e308])
    assert run(driver, clock, 1.0)[-1] == (177, 63, 177)
    assert driver.motion.positions == (LIMITS.upper, LIMITS.lower, LIMITS.upper)


@pytest.mark.parametrize("bad", [(math.nan, -1.0, -1.0), (-1.0, -1.0, math.inf), (-1.0,) * 2, (-1.0,) * 4])
def test_a_pose_of_the_board_that_is_none_is_not_taken_over(
    board: VirtualBoard, clock: TestClock, monkeypatch: pytest.MonkeyPatch, bad: tuple[float, ...]
) -> None:
    monkeypatch.setattr(LegacyProtocol, "pose", lambda self: bad)
    driver = ServoDriver(robot(), clock=clock, wait=clock.wait)
    driver.connect(board.port)
    driver.start()
    written: list[bytes] = []
    assert driver._transport is not None
    monkeypatch.setattr(driver._transport, "write", written.append)
    with pytest.raises(PortError, match="nothing was moved"):
        driver.tick()
    assert not written
    assert driver.motion.positions == driver.motion.rest
    driver.disconnect()


def test_commands_are_in_joint_order_and_packets_in_servo_order(
    board: VirtualBoard, clock: TestClock
) -> None:
    servos = [ServoCalibration(joint="c"), ServoCalibration(joint="a", sign=-1, zero_byte=90, trim_deg=2.5)]
    driver = ServoDriver(
        robot(*servos, limits=JointLimits(-1.5, 1.5, acceleration=1e9)),
        avoid_byte_100=False,
        clock=clock,
        wait=clock.wait,
    )
    driver.connect(board.port)
    driver.start()
    for command in (
        lambda: driver.command([0.5, 9.0, -1.0]),
        lambda: driver.command_named({"c": -1.0, "b": math.nan, "a": 0.5}),
    ):
        driver.start()
        command()
        assert run(driver, clock, 0.5)[-1] == (121, 90 + math.floor(2.5 - math.degrees(0.5)))
    driver.disconnect()


@pytest.mark.parametrize(("avoid", "byte"), [(True, 101), (False, 100)])
def test_byte_100_is_replaced_by_101_unless_switched_off(
    board: VirtualBoard, clock: TestClock, avoid: bool, byte: int
) -> None:
    driver = ServoDriver(robot(), avoid_byte_100=avoid, clock=clock, wait=clock.wait)
    driver.connect(board.port)
    driver.start()
    driver.command([math.radians(-78.5)] * 3)
    assert run(driver, clock, 0.4)[-1] == (byte,) * 3
    assert driver.applied_angles() == pytest.approx([math.radians(byte - 179)] * 3)
    driver.disconnect()


def test_after_connecting_ticks_send_unless_the_driver_stands_by(
    board: VirtualBoard, clock: TestClock
) -> None:
    driver = ServoDriver(robot(), clock=clock, wait=clock.wait)
    driver.connect(board.port)
    assert driver.tick() == (150, 150, 150)
    driver.stand_by()
    assert driver.tick() is None
    driver.start()
    assert driver.tick() == (150, 150, 150)
    driver.disconnect()


def test_without_a_port_nothing_can_be_sent(clock: TestClock) -> None:
    with pytest.raises(PortError, match="configure the bridge first"):
        ServoDriver(robot(), clock=clock).tick()


def test_robots_that_no_board_can_drive_are_refused() -> None:
    with pytest.raises(SceneError, match="has no servo board"):
        ServoDriver(RobotDescription(scene=SceneDescription(name="finger")))
    sliding = JointDescription(name="a", kind="prismatic")
    board = BoardDescription(servos=(ServoCalibration(joint="a"),))
    with pytest.raises(SceneError, match="must be revolute"):
        ServoDriver(RobotDescription(scene=SceneDescription(name="r", joints=(sliding,)), board=board))
