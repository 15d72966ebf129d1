"""From commands to packets on a port: one board's motion, protocol and port. No ROS; the clock is given."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from servo_bridge.errors import PortError, ProtocolError
from servo_bridge.link import BoardLink, Reader
from servo_bridge.protocols import AUTO, WAITING, Ability, EncodedPacket, TiltReading, candidates
from servo_bridge.safety import MotionSettings, ServoMotion, servo_limits
from servo_bridge.servo import bytes_to_angles
from servo_bridge.transport import SerialTransport
from softsim_core.errors import CommandError, SceneError, listing
from softsim_core.mechanics.limits import check_command
from softsim_core.scene.robot import RobotDescription

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
        restarts: Times that a board which says what it is was met, or met again after a reset.
    """

    packets: int = 0
    refused: int = 0
    last_refusal: str = ""
    avoided: int = 0
    restarts: int = 0


class ServoDriver:
    """Sends the newest command to the board, through limits and ramps, one packet a tick.

    Args:
        robot: Description with a board; its joints give names, order and limits.
        settings: Timing of hold and rest.
        rate: Packets a second in [Hz]; None takes the board's.
        avoid_byte_100: Send no byte 100 where the protocol can help it; see `BoardProtocol`.
        protocol: Name of what the board speaks; auto: as the robot's board says, else found out, see `link`.
        baud_rate: Bits a second; None takes the protocol's own where it has one, else the board's.
        on_tilt: Called with every reading of a board's IMU, in the reading thread.
        clock: Steady clock in [s].
        wait: Sleeps for a time in [s]; used only on the way to rest.

    Raises:
        SceneError: the robot has no board, a protocol that is unknown or does not fit its servos, or a servo
            whose rest byte lies outside its limits.
    """

    def __init__(
        self,
        robot: RobotDescription,
        *,
        settings: MotionSettings | None = None,
        rate: float | None = None,
        avoid_byte_100: bool = True,
        protocol: str = AUTO,
        baud_rate: int | None = None,
        on_tilt: Callable[[TiltReading], None] = lambda reading: None,
        clock: Callable[[], float] = time.monotonic,
        wait: Callable[[float], None] = time.sleep,
    ) -> None:
        if robot.board is None or not robot.board.servos:
            raise SceneError(
                f"robot {robot.name} has no servo board; add a section board to {robot.source or 'it'}"
            )
        self.board, self.servos = robot.board, robot.board.servos
        try:
            self._candidates = candidates(protocol, self.board)
        except ProtocolError as error:
            raise SceneError(f"robot {robot.name}: {error}") from error
        self.protocol = self._candidates[0].name if len(self._candidates) == 1 else AUTO
        self.baud_rate = baud_rate or self._candidates[-1].baud_rate or self.board.baud_rate
        self.on_tilt = on_tilt
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
            bytes_to_angles([servo.rest_byte for servo in self.servos], self.servos),
        )
        self.set_timing(settings or MotionSettings())
        self.avoid_byte_100 = avoid_byte_100
        self.counts = DriverCounts()
        self.sent_bytes: tuple[int, ...] | None = None
        self._clock, self._wait = clock, wait
        self._order = [self.joint_names.index(name) for name in self.servo_joints]
        self.link: BoardLink | None = None
        self._transport: SerialTransport | None = None
        self._reader: Reader | None = None
        self._applied: tuple[float, ...] = (math.nan,) * len(self.servos)
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
        return self.link_state == WAITING

    @property
    def link_state(self) -> str | None:
        """Name of the protocol found, or WAITING: it is too early to say; None without a port."""
        return None if self.link is None else self.link.state(self._clock())

    @property
    def telemetry_age(self) -> float | None:
        """Time in [s] since a board that says what it is last spoke; None before the first time."""
        return None if self.link is None else self.link.heard_age(self._clock())

    @property
    def tilt_age(self) -> float | None:
        """Time in [s] since the newest reading of the board's IMU; None before the first."""
        return None if self.link is None else self.link.tilt_age(self._clock())

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
        """Open the port and listen; nothing is written until the board spoke, or for `quiet_s` seconds.

        Raises:
            PortError: it cannot be opened.
        """
        self.disconnect()
        self._transport = SerialTransport(port, self.baud_rate)
        self.link = BoardLink(port, [each(self.board) for each in self._candidates], quiet_s, self._clock())
        self._reader = Reader(self._transport, self.link, self._clock, self.on_tilt)
        self._board_moved = False

    def disconnect(self, *, relax: bool = False) -> None:
        """Close the port, if one is open; the last pose sent stays known.

        Args:
            relax: Switch the pulses off first, where the board can and its servos were left at rest.
        """
        if relax:
            self._relax()
        reader, self._reader = self._reader, None
        transport, self._transport = self._transport, None
        if reader is not None:
            reader.stop()
        if transport is not None:
            transport.close()
        self.link = None

    def _relax(self) -> None:
        if self._transport is None or self.link is None or not self._board_moved or self.waiting:
            return
        if self.motion.e_stopped or not self.motion.at_rest:
            return  # an e-stop holds
        with contextlib.suppress(PortError):
            with self.link.speaking() as board:
                packet = board.relax() if Ability.RELAX in board.abilities else b""
            if packet:
                self._transport.write(packet)

    def start(self) -> None:
        """Begin to move from the last pose sent (at first the rest pose); earlier commands do not count."""
        self.motion.start(self._clock())

    def command(self, values: Sequence[float]) -> None:
        """Take a command of one position per joint of the robot, in its order, in [rad].

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
        """Look whether the board still lives; the way to notice, without writing, that the port has vanished.

        Raises:
            PortError: the port vanished, telemetry stopped, or the board is not the one asked for.
        """
        if self.link is not None:
            self.link.check(self._clock())

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
        if self._transport is None or self.link is None:
            raise PortError("", "no port is open; configure the bridge first")
        now = self._clock()
        self.link.check(now)
        if self.link.state(now) == WAITING:
            self.motion.start(now)
            return None
        if self.link.take_restart():
            self._greet(now)
            return None
        before = self.motion.positions
        try:
            packet = self._encode(step(now))
            self._transport.write(packet if isinstance(packet, bytes) else packet.data)
        except PortError:
            self.motion.positions = before
            raise
        self._board_moved = True
        self.counts.packets += 1
        if isinstance(packet, EncodedPacket):
            self.counts.avoided += packet.avoided
            self.sent_bytes, self._applied = packet.servo_bytes, packet.angles_rad
        return self.sent_bytes

    def _encode(self, positions: Sequence[float]) -> EncodedPacket | bytes:
        """The pose; while the e-stop is latched the word to hold, which says no pose, where the board can."""
        assert self.link is not None
        with self.link.speaking() as board:
            if self.motion.e_stopped and Ability.HOLD in board.abilities:
                return board.hold()
            board.avoid_byte_100 = self.avoid_byte_100
            return board.encode(positions)

    def _greet(self, now: float) -> None:
        """A board has (re)started: begin with its pose where it has one, and tell it the servos' ranges."""
        assert self._transport is not None
        assert self.link is not None
        self.counts.restarts += 1
        with self.link.speaking() as board:
            pose = board.pose()
            if pose is not None:
                self.motion.resume_from(check_command(pose, self.servo_joints))
            limits = board.limits() if Ability.LIMITS in board.abilities else b""
        self.motion.start(now)
        if limits:
            self._transport.write(limits)

    def applied_angles(self) -> tuple[float, ...]:
        """Nominal joint angles in [rad] of what was last sent, in servo order; NaN before the first."""
        return self._applied

    def _refuse(self, error: CommandError) -> None:
        self.counts.refused += 1
        self.counts.last_refusal = str(error)
