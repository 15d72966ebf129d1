"""The stop at random moments of every state of the driver, measured in the cycles of the emulated board."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest
from lock_step import LockStep

from servo_bridge import PortError
from servo_bridge.emulator import EmulatedBoard

LONGEST_WAY_IN_S = {
    "driving": 0.3,
    "activating": 0.3,
    "deactivating": 0.4,
    "configuring": 1.5,
    "reconnecting": 1.5,
}
"""How far into each state in [s] the stop comes at most."""

WITHIN_S = 0.025
"""Longest time in [s] from the stop to the last pulse of another width: a packet, and a frame of pulses."""

WHOLE_MOVE_S = 0.6
"""Long enough in [s] for a way from limit to limit."""

MOVING_S = 0.045
"""A width that changed so shortly before the stop in [s] was still changing: two frames of pulses."""

TIMES = pytest.mark.parametrize("times", [6, pytest.param(60, marks=pytest.mark.exhaustive)])


class Stopped(LockStep):
    """A driver that follows random poses; its e-stop's packet leaves at once, as the bridge's does."""

    def __init__(self, board: EmulatedBoard, seed: int, line: Callable[[bytes], bytes] = bytes) -> None:
        super().__init__(board, line=line)
        self.random, self._low = random.Random(seed), True
        self.connect()
        self.drive(0.2)

    def command(self, seconds: float) -> None:
        """Follow a pose near the other end of the range for so long."""
        self._low = not self._low
        low, high = (60, 70) if self._low else (170, 181)
        self.drive(seconds, [self.random.randrange(low, high) for _ in range(3)])

    def get_to(self, state: str) -> None:
        """To a random moment of that state, on the way from one end of the range to the other."""
        driver = self.driver
        if state != "driving":
            self.command(0.1)
        if state in ("activating", "configuring"):
            assert driver.settle()
        if state == "activating":
            driver.start()
        elif state == "deactivating":
            assert driver.begin_settling(1.5)
        elif state == "configuring":
            driver.disconnect(relax=True)
            self.connect()
        elif state == "reconnecting":
            self.unplug()
            self.plugged = True
            self.connect(again=True)
        self.command(self.random.uniform(0.0, LONGEST_WAY_IN_S[state]))
        self.run(self.random.uniform(0.0, driver.period))

    def stop(self) -> float:
        """Latch the e-stop; when, in [s] of the board."""
        called = self.board.time_s
        self.driver.motion.e_stop.latch()
        self.driver.tick()
        self.run(self.random.uniform(0.0, self.driver.period))
        return called

    def clear(self) -> None:
        self.driver.motion.e_stop.clear()


@TIMES
@pytest.mark.parametrize("state", LONGEST_WAY_IN_S)
def test_no_pulse_changes_after_the_stop_nor_after_its_clearing(
    board: EmulatedBoard, state: str, times: int
) -> None:
    robot = Stopped(board, list(LONGEST_WAY_IN_S).index(state))
    moving = 0
    for number in range(times):
        robot.driver.start()
        robot.command(WHOLE_MOVE_S)
        robot.get_to(state)
        call = robot.stop()
        robot.command(0.5)  # to the other end of the range
        late = robot.last_change_s() - call
        moving += late > -MOVING_S
        assert late <= WITHIN_S, (state, number)
        robot.clear()
        robot.drive(0.5)
        assert robot.last_change_s() - call <= WITHIN_S, (state, number)
        board.clear()
    assert state != "driving" or 2 * moving > times
    robot.close()


@TIMES
@pytest.mark.parametrize("loss", ["stopped", "killed", "line cut"])
def test_no_pulse_changes_where_the_bridge_is_lost_after_the_stop(
    board: EmulatedBoard, loss: str, times: int
) -> None:
    cut = False  # both ways; the board keeps its power
    robot = Stopped(board, len(loss), lambda data: b"" if cut else data)
    for number in range(times):
        robot.command(WHOLE_MOVE_S)
        robot.get_to("driving")
        call = robot.stop()
        if loss == "line cut":
            cut = True
            robot.reset_wired = False  # else opening the port again switches the pulses off
            with pytest.raises(PortError, match="no telemetry"):
                robot.drive(3.0)
            robot.close()
        robot.run(3.0)  # silence leads to rest after two
        assert board.pulses[-1].start_s > board.time_s - 0.1, (loss, number)
        assert robot.last_change_s() - call <= WITHIN_S, (loss, number)
        cut = False
        if loss == "killed":
            killed = robot.driver
            robot.new_driver()
            robot.connect()
            killed.disconnect()
        elif loss == "line cut":
            robot.connect(again=True)
        else:
            robot.clear()
        robot.drive(0.5)
        robot.clear()
        robot.drive(0.5)
        assert robot.last_change_s() - call <= WITHIN_S, (loss, number)
        robot.reset_wired = True
        board.clear()
    robot.close()
