"""From commands to packets on a port: one board's motion, codec and transport. No ROS; the clock is given."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from servo_bridge import codec
from servo_bridge.errors import PortError
from servo_bridge.safety import MotionSettings, ServoMotion, servo_limits
from servo_bridge.transport import SerialTransport
from softsim_core.actuation.limits import check_command
from softsim_core.errors import CommandError, SceneError, listing
from softsim_core.scene.description import SceneDescription

REST_REPEATS = 3
"""Rest packets sent at the end, so that one byte lost on the line does not decide where the servos stay."""


@dataclass(slots=True)
class DriverCounts:
    """What the driver did since it was made.

    Attributes:
        packets: Packets written.
        refused: Commands refused as a whole.
        last_refusal: Sentence of the newest refusal.
        avoided: Packets in which a byte 100 was replaced.
    """

    packets: int = 0
    refused: int = 0
    last_refusal: str = ""
    avoided: int = 0


class ServoDriver:
    """Sends the newest command to the board, through limits and ramps, one packet a tick.

    Args:
        robot: Description with a board; its joints give names, order and limits.
        settings: Timing of hold and rest.
        rate: Packets a second in [Hz]; None takes the board's.
        avoid_byte_100: Send 101 for 100; see `codec.avoid_byte_100`.
        clock: Steady clock in [s].
        wait: Sleeps for a time in [s]; used only on the way to rest.

    Raises:
        SceneError: the robot has no board, or a servo's rest byte lies outside its limits.
    """

    def __init__(
        self,
        robot: SceneDescription,
        *,
        settings: MotionSettings | None = None,
        rate: float | None = None,
        avoid_byte_100: bool = True,
        clock: Callable[[], float] = time.monotonic,
        wait: Callable[[float], None] = time.sleep,
    ) -> None:
        if robot.board is None or not robot.board.servos:
            raise SceneError(
                f"robot {robot.name} has no servo board; add a section board to {robot.source or 'it'}"
            )
        self.board, self.servos = robot.board, robot.board.servos
        self.joint_names = robot.joint_names
        self.servo_joints = tuple(servo.joint for servo in self.servos)
        joints = {joint.name: joint for joint in robot.joints}
        for name in self.servo_joints:
            if joints[name].kind != "revolute":
                raise SceneError(f"robot {robot.name}: joint {name} of a servo must be revolute")
        self.period = 1.0 / (rate or self.board.rate)
        self.motion = ServoMotion(
            self.servo_joints,
            [servo_limits(servo, joints[servo.joint].limits) for servo in self.servos],
            codec.bytes_to_angles([servo.rest_byte for servo in self.servos], self.servos),
        )
        self.set_timing(settings or MotionSettings())
        self.avoid_byte_100 = avoid_byte_100
        self.counts = DriverCounts()
        self.sent_bytes: tuple[int, ...] | None = None
        self._clock, self._wait = clock, wait
        self._order = [self.joint_names.index(name) for name in self.servo_joints]
        self._transport: SerialTransport | None = None
        self._write_from = 0.0
        self._board_moved = False  # since the port was opened

    @property
    def port(self) -> str:
        """Name of the port in use; empty without one."""
        return "" if self._transport is None else self._transport.port

    @property
    def connected(self) -> bool:
        """Whether a port is open."""
        return self._transport is not None

    @property
    def waiting(self) -> bool:
        """Whether the board is still given its quiet time after the port was opened."""
        return self._clock() < self._write_from

    @property
    def command_age(self) -> float | None:
        """Time in [s] since the newest accepted command; None before the first."""
        return self.motion.command_age(self._clock())

    def set_timing(self, settings: MotionSettings) -> None:
        """Take new hold and rest times at once; the longest step stays two periods."""
        self.motion.settings = MotionSettings(
            hold_timeout_s=settings.hold_timeout_s,
            rest_timeout_s=settings.rest_timeout_s,
            rest_speed=settings.rest_speed,
            longest_step_s=2.0 * self.period,
        )

    def connect(self, port: str, quiet_s: float = 0.0) -> None:
        """Open the port; nothing is written for `quiet_s` seconds, while the board starts.

        Raises:
            PortError: it cannot be opened.
        """
        self.disconnect()
        self._transport = SerialTransport(port, self.board.baud_rate)
        self._write_from = self._clock() + quiet_s
        self._board_moved = False

    def disconnect(self) -> None:
        """Close the port, if one is open; the last pose sent stays known."""
        transport, self._transport = self._transport, None
        if transport is not None:
            transport.close()

    def start(self) -> None:
        """Begin to move from the last pose sent (at first the rest pose); earlier commands do not count."""
        self.motion.start(self._clock())

    def command(self, values: Sequence[float]) -> None:
        """Take a command of one position a joint of the robot, in its order, in [rad].

        Raises:
            CommandError: wrong length or a value that is not finite; nothing of it is used.
        """
        try:
            checked = check_command(values, self.joint_names)
            self.motion.command([checked[index] for index in self._order], self._clock())
        except CommandError as error:
            self._refuse(error)
            raise

    def command_named(self, positions: Mapping[str, float]) -> None:
        """Take positions in [rad] by joint name; names that drive no servo are ignored.

        Raises:
            CommandError: a servo's joint is missing, or its value is not finite; nothing of it is used.
        """
        try:
            missing = [name for name in self.servo_joints if name not in positions]
            if missing:
                raise CommandError(
                    f"joint states without {listing(missing)} refused; they name {listing(positions)};"
                    " nothing was moved"
                )
            self.motion.command([positions[name] for name in self.servo_joints], self._clock())
        except CommandError as error:
            self._refuse(error)
            raise

    def tick(self) -> tuple[int, ...] | None:
        """Send one packet for now; call it once a period.

        Returns:
            The servo bytes sent; None while the board is given its quiet time.

        Raises:
            PortError: the port vanished or takes no data; the pose stays the last one sent.
        """
        return self._send(self.motion.step)

    def listen(self) -> None:
        """Drop what the board said; also the way to notice, without writing, that the port has vanished.

        Raises:
            PortError: the port vanished.
        """
        if self._transport is not None:
            self._transport.discard_input()

    def settle(self, timeout_s: float = 1.5, sent: Callable[[], None] = lambda: None) -> bool:
        """Go to the rest pose at the limits' speed and end with rest packets; blocks until then.

        A latched e-stop is kept: nothing moves. When the way takes longer than `timeout_s` seconds the last
        packets are at rest all the same.

        Args:
            timeout_s: Longest time for the ramp in [s].
            sent: Called after each packet.

        Returns:
            Whether the last packet was the rest pose.
        """
        if self._transport is None or self.motion.e_stopped or not self._board_moved:
            return False  # no port, not allowed, or no need: this board has not been told to move
        deadline = self._clock() + timeout_s
        try:
            while not self.motion.at_rest and self._clock() < deadline:
                self._wait(self.period)
                self._send(self.motion.step_to_rest)
                sent()
            self.motion.positions = self.motion.rest
            for _ in range(REST_REPEATS):
                self._wait(self.period)
                self._send(self.motion.step_to_rest)
                sent()
        except PortError:
            return False
        return True

    def _send(self, step: Callable[[float], tuple[float, ...]]) -> tuple[int, ...] | None:
        if self._transport is None:
            raise PortError("", "no port is open; configure the bridge first")
        self._transport.discard_input()
        now = self._clock()
        if now < self._write_from:
            self.motion.start(now)
            return None
        before = self.motion.positions
        packet = codec.encode_packet(step(now), self.servos, self.board.header)
        try:
            if self.avoid_byte_100:
                safe = codec.avoid_byte_100(packet, self.servos)
                self.counts.avoided += safe != packet
                packet = safe
            self._transport.write(packet)
        except PortError:
            self.motion.positions = before
            raise
        self._board_moved = True
        self.counts.packets += 1
        self.sent_bytes = tuple(packet[1:])
        return self.sent_bytes

    def applied_angles(self) -> tuple[float, ...]:
        """Nominal joint angles in [rad] of the bytes last sent, in servo order; NaN before the first."""
        if self.sent_bytes is None:
            return (math.nan,) * len(self.servos)
        return codec.bytes_to_angles(self.sent_bytes, self.servos)

    def _refuse(self, error: CommandError) -> None:
        self.counts.refused += 1
        self.counts.last_refusal = str(error)
