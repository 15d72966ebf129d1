"""From commands to packets on a port: one board's motion, codec and transport. No ROS; the clock is given."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from servo_bridge import codec, frames, outgoing
from servo_bridge.ascii_codec import ASCII_BAUD_RATE, TiltReading
from servo_bridge.errors import PortError
from servo_bridge.link import BoardLink, LinkState, ProtocolChoice, Reader
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
        restarts: Times that a board of the extended protocol was met, or met again after a reset.
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
        avoid_byte_100: Send 101 for 100; see `codec.avoid_byte_100`.
        protocol: What the board speaks; auto finds out, see `link`.
        baud_rate: Bits a second; None takes the protocol's: 57600 for ascii_imu, else the board's.
        on_tilt: Called with every reading of a board's IMU, in the reading thread.
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
        protocol: ProtocolChoice = "auto",
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
        self.protocol, self.on_tilt = _usable(protocol, robot), on_tilt
        self.baud_rate = baud_rate or (ASCII_BAUD_RATE if protocol == "ascii_imu" else self.board.baud_rate)
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
        self.link: BoardLink | None = None
        self._transport: SerialTransport | None = None
        self._reader: Reader | None = None
        self._seq = 0
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
        return self.link_state == "waiting"

    @property
    def link_state(self) -> LinkState | None:
        """The protocol found, or that it is too early to say; None without a port."""
        return None if self.link is None else self.link.state(self._clock())

    @property
    def telemetry_age(self) -> float | None:
        """Time in [s] since the board's newest frame; None before the first."""
        return None if self.link is None else self.link.telemetry_age(self._clock())

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
        self.link = BoardLink(port, self.protocol, quiet_s, self._clock())
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
        if self._transport is None or not self._board_moved or self.link_state != "extended":
            return
        if self.motion.e_stopped or not self.motion.at_rest:
            return  # an e-stop holds
        with contextlib.suppress(PortError):
            self._transport.write(frames.relax(self._next_seq()))

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
        state = self.link.state(now)
        if state == "waiting":
            self.motion.start(now)
            return None
        if state == "extended" and self.link.take_restart():
            self._greet(now)
            return None
        before = self.motion.positions
        packet = self._encode(step(now), state)
        if state == "extended":
            self.link.sent(self._seq)  # before: the acknowledgement may come while the write returns
        try:
            self._transport.write(packet.data)
        except PortError:
            self.motion.positions = before
            raise
        self._board_moved = True
        self.counts.packets += 1
        self.counts.avoided += packet.avoided
        if state == "extended" and self.motion.e_stopped:
            return self.sent_bytes  # what was sent says "hold", and no pose
        self.sent_bytes, self._applied = packet.servo_bytes, packet.angles_rad
        return self.sent_bytes

    def _encode(self, positions: Sequence[float], state: LinkState) -> outgoing.Outgoing:
        if state == "extended":
            seq = self._next_seq()
            pose = outgoing.extended(positions, self.servos, seq)
            return replace(pose, data=frames.hold(seq)) if self.motion.e_stopped else pose
        if state == "ascii_imu":
            return outgoing.ascii_line(positions, self.servos)
        return outgoing.legacy(positions, self.servos, self.board.header, self.avoid_byte_100)

    def _greet(self, now: float) -> None:
        """A board has (re)started: begin with its pose where it has one, and tell it the servos' ranges."""
        assert self._transport is not None
        assert self.link is not None
        self.counts.restarts += 1
        telemetry = self.link.telemetry
        if telemetry is not None and frames.BoardFlags.ACTIVE in telemetry.flags:
            widths = telemetry.widths_us[: len(self.servos)]
            self.motion.resume_from(
                [codec.width_to_angle(width, servo) for width, servo in zip(widths, self.servos, strict=True)]
            )
        self.motion.start(now)
        limits = [codec.width_limits(servo) for servo in self.servos]
        seq = self._next_seq()
        self.link.sent(seq)
        self._transport.write(frames.set_limits(seq, limits))

    def _next_seq(self) -> int:
        self._seq = (self._seq + 1) % frames.SEQUENCES
        return self._seq

    def applied_angles(self) -> tuple[float, ...]:
        """Nominal joint angles in [rad] of what was last sent, in servo order; NaN before the first."""
        return self._applied

    def _refuse(self, error: CommandError) -> None:
        self.counts.refused += 1
        self.counts.last_refusal = str(error)


def _usable(protocol: ProtocolChoice, robot: SceneDescription) -> ProtocolChoice:
    """The protocol, where the robot's servos fit it; auto is legacy for any other number than three."""
    assert robot.board is not None
    servos = robot.board.servos
    if len(servos) != frames.SERVOS:
        if protocol == "extended":
            raise SceneError(
                f"robot {robot.name} has {len(servos)} servos, the extended protocol {frames.SERVOS};"
                " set the parameter protocol to legacy"
            )
        return "legacy" if protocol == "auto" else protocol
    if protocol == "ascii_imu":
        for servo in servos:
            if servo.byte_min < codec.BYTE_LOW or servo.byte_max > codec.BYTE_HIGH:
                raise SceneError(
                    f"servo {servo.joint}: the text protocol allows bytes"
                    f" {codec.BYTE_LOW}..{codec.BYTE_HIGH}, not {servo.byte_min}..{servo.byte_max}"
                )
    return protocol
