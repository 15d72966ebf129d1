"""A servo driver and an emulated board on one clock: simulated time that passes only where a test lets it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from functools import cache
from itertools import pairwise

from servo_bridge import PortError
from servo_bridge.driver import ServoDriver, byte_to_width, bytes_to_angles
from servo_bridge.emulator import EmulatedBoard
from softsim_core import load_scene
from softsim_core.scene import RobotDescription

SLICE_S = 0.005
"""What the board says reaches the driver at most so much later, in [s]."""

QUIET_S = 2.5
TOLERANCE_US = 1.5
REST = (150, 150, 150)


@cache
def tripod() -> RobotDescription:
    """The Tripod, whose board has three servos."""
    return load_scene("tripod")


class BoardLine:
    """The driver's end of the line to an emulated board.

    Args:
        port: Name of the port.
        write: Takes what the driver sends.
    """

    def __init__(self, port: str, write: Callable[[bytes], None]) -> None:
        self.port = port
        self._write = write
        self._closed = threading.Event()

    def write(self, packet: bytes) -> None:
        """Put a packet on the line."""
        self._write(packet)

    def read(self) -> bytes:
        """Nothing, at the end: `LockStep` hands the driver what the board says."""
        self._closed.wait()
        return b""

    def cancel_read(self) -> None:
        self._closed.set()

    def close(self) -> None:
        self._closed.set()


class LockStep:
    """A driver on an emulated board; opening the port resets the board, as on a real one.

    Args:
        board: Its clock is the driver's.
        line: What the line makes of bytes, either way.
        robot: None for the Tripod.

    Attributes:
        driver: The driver.
        received: Number of bytes that left for the board.
        reset_wired: Whether opening the port resets the board.
        plugged: Whether the board is there; without it the port cannot be opened or used.
    """

    def __init__(
        self,
        board: EmulatedBoard,
        *,
        line: Callable[[bytes], bytes] = bytes,
        robot: RobotDescription | None = None,
    ) -> None:
        self.board, self._line = board, line
        self._robot = robot or tripod()
        self.received = 0
        self.reset_wired = self.plugged = True
        self.driver = self.new_driver()

    def new_driver(self) -> ServoDriver:
        """A driver that has met no board, as of a bridge that starts."""
        self.driver = ServoDriver(
            self._robot, clock=lambda: self.board.time_s, wait=self.run, open_port=self._open
        )
        return self.driver

    def connect(self, *, again: bool = False, silent_allowed: bool = True) -> None:
        """Open the port and send from there on."""
        self.driver.connect("board", QUIET_S, again=again, silent_allowed=silent_allowed)
        self.driver.start()

    def unplug(self) -> None:
        """Pull the cable: the port vanishes, and the servos lose power."""
        self.plugged = False
        self.board.power_cycle()
        if self.driver.link is not None:
            self.driver.link.fail(PortError("board", "port board vanished"))

    def run(self, seconds: float) -> None:
        """Let time pass without a packet; the driver hears the board."""
        end = self.board.time_s + seconds
        while (left := end - self.board.time_s) > 1e-6:
            self.board.run(min(left, SLICE_S))
            said, link = self._line(self.board.take_transmitted()), self.driver.link
            if link is not None and self.plugged:
                link.receive(said, self.board.time_s)

    def drive(self, seconds: float, pose: Sequence[float] | None = None) -> None:
        """Send at the driver's rate, following a pose in servo bytes; None: without a command."""
        for _ in range(round(seconds / self.driver.period)):
            self._period(pose)

    def drive_until(
        self, reached: Callable[[], bool], pose: Sequence[float] | None = None, limit_s: float = 10.0
    ) -> bool:
        """Send until a condition holds; False when `limit_s` of simulated time passed first."""
        end = self.board.time_s + limit_s
        while not reached():
            if self.board.time_s > end:
                return False
            self._period(pose)
        return True

    def drive_to(self, *pose: float) -> None:
        """Send a pose in servo bytes until the pins show it."""
        assert self.drive_until(lambda: self.at(*pose), pose), (pose, self.board.widths_us())

    def at(self, *pose: float) -> bool:
        """Whether the newest pulses are those of servo bytes."""
        widths = self.board.widths_us()
        return widths is not None and all(
            abs(seen - byte_to_width(each)) < TOLERANCE_US for seen, each in zip(widths, pose, strict=True)
        )

    def largest_step_us(self) -> float:
        """Largest change of a width from one pulse of a pin to the next."""
        pins = [[each.width_us for each in self.board.pulses if each.channel == pin] for pin in range(3)]
        return max((abs(b - a) for widths in pins for a, b in pairwise(widths)), default=0.0)

    def last_change_s(self) -> float:
        """When the newest pulse began that had another width than the one before, in [s] of the board."""
        newest = 0.0
        for pin in range(3):
            pulses = [pulse for pulse in self.board.pulses if pulse.channel == pin]
            for before, after in pairwise(pulses):
                if abs(after.width_us - before.width_us) > TOLERANCE_US:
                    newest = max(newest, after.start_s)
        return newest

    def close(self) -> None:
        """Close the driver's port."""
        self.driver.disconnect()

    def _period(self, pose: Sequence[float] | None) -> None:
        if pose is not None:
            assert self._robot.board is not None
            self.driver.command(bytes_to_angles(pose, self._robot.board.hobby_servos))
        self.driver.tick()
        self.run(self.driver.period)

    def _open(self, port: str, baud_rate: int) -> BoardLine:
        self._need_board(port)
        if self.reset_wired:
            self.board.reset()
            self.board.take_transmitted()
        return BoardLine(port, self._write)

    def _write(self, packet: bytes) -> None:
        self._need_board("board")
        self.received += len(packet)
        self.board.feed(self._line(packet))

    def _need_board(self, port: str) -> None:
        if not self.plugged:
            raise PortError(port, f"port {port} vanished")
