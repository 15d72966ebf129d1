"""What the tests of the driver on a board that talks back share: a robot, a clock, and ways to tick."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from node_processes import spin_until

from servo_bridge.driver import ServoDriver
from servo_bridge.protocols import BoardFlags
from softsim_core.physics.mechanics import JointLimits
from softsim_core.scene import (
    BoardDescription,
    JointDescription,
    RobotDescription,
    SceneDescription,
    ServoCalibration,
)

PERIOD = 0.02
Wait = Callable[..., bool]


LIMITS = JointLimits(-2.0225, -0.0255, 3.5, 1e9)


def robot(count: int = 3, limits: JointLimits = LIMITS, **servo: int) -> RobotDescription:
    names = [f"j{number}" for number in range(count)]
    return RobotDescription(
        scene=SceneDescription(
            name="robot", joints=tuple(JointDescription(name=name, limits=limits) for name in names)
        ),
        board=BoardDescription(servos=tuple(ServoCalibration(joint=name, **servo) for name in names)),
    )


class TestClock:
    """A clock that moves only when told to, or when somebody waits."""

    __test__ = False

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now

    def wait(self, duration_s: float) -> None:
        self.now += duration_s


class PacedDriver:
    """A driver on a clock of the test's own, which waits for a board that runs in real time.

    Attributes:
        driver: The driver.
        now: Time of its clock in [s].
    """

    def __init__(self, robot: RobotDescription) -> None:
        self.now = 100.0
        self.driver = ServoDriver(robot, clock=lambda: self.now, wait=self.wait)

    def wait(self, duration_s: float) -> None:
        """Advance the clock; wait for telemetry where the board is behind it."""
        self.now += duration_s
        if (self.driver.telemetry_age or 0.0) > 0.2:
            assert spin_until(lambda: self.driver.telemetry_age == 0.0)

    def follow(self, command: Sequence[float], count: int) -> None:
        """Send a command as often as its sender does, for some packets."""
        for _ in range(count):
            self.driver.command(command)
            self.wait(PERIOD)
            self.driver.tick()


def run(driver: ServoDriver, clock: TestClock, duration_s: float) -> list[tuple[int, ...] | None]:
    sent = []
    for _ in range(round(duration_s / PERIOD)):
        clock.wait(PERIOD)
        sent.append(driver.tick())
    return sent


def take_over(driver: ServoDriver) -> None:
    """Tick until the board has told where it stands and was sent the first pose."""
    assert spin_until(lambda: driver.tick() is not None)


def flags(driver: ServoDriver) -> BoardFlags:
    assert driver.link is not None
    return BoardFlags(0) if driver.link.board.telemetry is None else driver.link.board.telemetry.flags
