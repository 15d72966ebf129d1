"""From commands to packets on a port: one board's motion, protocol and port. No ROS; the clock is given.

Two threads may use a driver: one ticks, the other gives commands. The e-stop needs neither: it is a latch
that every tick looks at first.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

from servo_bridge.board_port import BoardPort
from servo_bridge.e_stop import EStop
from servo_bridge.errors import PortError, ProtocolError
from servo_bridge.link import BoardLink
from servo_bridge.protocols import AUTO, WAITING, Ability, BoardProtocol, TiltReading, candidates
from servo_bridge.safety import MotionSettings, ServoMotion, servo_limits
from servo_bridge.servo import bytes_to_angles
from servo_bridge.takeover import Takeover
from servo_bridge.transport import SerialTransport
from servo_bridge.wording import named, sentence
from softsim_core.errors import CommandError, SceneError
from softsim_core.mechanics.limits import check_command
from softsim_core.mechanics.named_command import check_named_command
from softsim_core.scene.robot import RobotDescription

REST_REPEATS = 3
"""Last packets are sent so often: one byte lost on the line does not decide where the servos stay."""

STALL_S = 0.4
"""Longer without a tick in [s], and the bridge stood still: a board of ours holds after 0.5 s by itself."""

SLOWEST_HZ, FASTEST_HZ = 10.0, 200.0
"""Allowed packets a second: less, and a board takes the pauses for silence; more, and the line is full."""

SAME_POSE = math.radians(1.5)
"""Poses of board and bridge nearer than this in [rad] are one: a hobby servo's dead band."""

Course: TypeAlias = Literal["idle", "send", "settle"]
"""What a tick is for: only to listen, to follow commands, or to go to rest and end there."""


def steady_time() -> float:
    """Steady clock in [s] that also counts the time in which the computer was suspended."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


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


class ServoDriver(BoardPort):
    """Sends the newest command to the board, through limits and ramps, one packet a tick.

    Args:
        robot: Description with a board; its joints give names, order and limits.
        settings: Timing of hold and rest.
        rate: Packets a second in [Hz]; None takes the board's.
        avoid_byte_100: Send no byte 100 where the protocol can help it; see `BoardProtocol`.
        protocol: Name of what the board speaks; auto: as the robot's board says, else found out, see `link`.
        baud_rate: Bits a second; None takes the protocol's own where it has one, else the board's.
        on_tilt: Called with every reading of a board's IMU, in the reading thread.
        e_stop: The latch that every tick looks at; None makes one.
        clock: Steady clock in [s].
        wait: Sleeps for a time in [s]; used only by `settle`.

    Attributes:
        takeover: Whether and why the board's pose has to be asked for before a pose is sent.
        settled: Set while the driver is not on the way to rest.
        sending: Whether the last tick told the board a pose, or to hold.

    Raises:
        SceneError: the robot has no board, a protocol that is unknown or does not fit its servos, a servo
            whose rest byte lies outside its limits, or a rate that is not allowed.
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
        e_stop: EStop | None = None,
        clock: Callable[[], float] = steady_time,
        wait: Callable[[float], None] = time.sleep,
    ) -> None:
        if robot.board is None or not robot.board.servos:
            raise SceneError(
                f"robot {robot.name} has no servo board; add a section board to {robot.source or 'it'}"
            )
        try:
            spoken = candidates(protocol, robot.board)
        except ProtocolError as error:
            raise SceneError(f"robot {robot.name}: {error}") from error
        baud = baud_rate or spoken[-1].baud_rate or robot.board.baud_rate
        super().__init__(robot.board, spoken, baud, on_tilt, clock)
        self.protocol = spoken[0].name if len(spoken) == 1 else AUTO
        self.joint_names = robot.joint_names
        self.servo_joints = tuple(servo.joint for servo in self.servos)
        joints = {joint.name: joint for joint in robot.joints}
        for name in self.servo_joints:
            if joints[name].kind != "revolute":
                raise SceneError(f"robot {robot.name}: joint {name} of a servo must be revolute")
        self.period = _period(robot.name, rate or self.board.rate)
        self.motion = ServoMotion(
            self.servo_joints,
            [servo_limits(servo, joints[servo.joint].limits) for servo in self.servos],
            bytes_to_angles([servo.rest_byte for servo in self.servos], self.servos),
            e_stop=e_stop,
        )
        self._lock = threading.RLock()
        self.set_timing(settings or MotionSettings())
        self.avoid_byte_100 = avoid_byte_100
        self.counts = DriverCounts()
        self.takeover = Takeover()
        self.settled = threading.Event()
        self.settled.set()
        self.sending = False
        self.sent_bytes: tuple[int, ...] | None = None
        self._wait = wait
        self._order = [self.joint_names.index(name) for name in self.servo_joints]
        self._applied: tuple[float, ...] = (math.nan,) * len(self.servos)
        self._board_moved = False  # since the port was opened
        self._course: Course = "send"
        self._held = False  # the last tick found the e-stop latched
        self._last_tick: float | None = None
        self._settle_until = 0.0
        self._rest_packets = 0  # sent at the end of the way to rest

    @property
    def command_age(self) -> float | None:
        """Time in [s] since the newest accepted command; None before the first."""
        return self.motion.command_age(self._clock())

    def set_timing(self, settings: MotionSettings) -> None:
        """Take new hold and rest times at once; the longest step stays two periods."""
        with self._lock:
            self.motion.settings = replace(settings, longest_step_s=2.0 * self.period)

    def connect(self, port: str, quiet_s: float = 0.0) -> None:
        """Open the port; nothing is written until the board spoke, or for `quiet_s` seconds; ticks send then.

        Raises:
            PortError: it cannot be opened.
        """
        self.disconnect()
        transport = SerialTransport(port, self.baud_rate)
        with self._lock:
            self._open(transport, quiet_s)
            self._course = "send"
            self._board_moved = self._held = False
            self._last_tick = None
            self.takeover.begin()

    def disconnect(self, *, relax: bool = False) -> None:
        """Close the port, if one is open; the last pose sent stays known.

        Args:
            relax: Switch the pulses off first, where the board can and its servos were left at rest.
        """
        with self._lock:
            if self.motion.e_stop.latched:
                self.hold_board()
            elif relax and self._board_moved and self.motion.at_rest and not self.waiting:
                with contextlib.suppress(PortError):
                    self._say(Ability.RELAX)
            close = self._take_out()
            self._end_course()
        close()

    def start(self) -> None:
        """Begin to send from the board's pose, else the last one sent (at first the rest pose).

        Earlier commands do not count.
        """
        with self._lock:
            self.motion.start(self._clock())
            self.takeover.begin()
            self._course, self._last_tick = "send", None

    def stand_by(self) -> None:
        """Only listen from now on, and tell a board that can hold to do so while the e-stop is latched."""
        with self._lock:
            self._end_course()

    def command(self, values: Sequence[float]) -> None:
        """Take a command of one position per joint of the robot, in its order, in [rad].

        Raises:
            CommandError: wrong length or a value that is not finite; nothing of it is used.
        """
        try:
            checked = check_command(values, self.joint_names)
            with self._lock:
                self.motion.command([checked[index] for index in self._order], self._clock())
        except CommandError as error:
            self.refuse(error)
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
                    f"joint states without {named(missing)} refused; they name {named(positions)};"
                    " nothing was moved"
                )
            with self._lock:
                self.motion.command([positions[name] for name in self.servo_joints], self._clock())
        except CommandError as error:
            self.refuse(error)
            raise

    def command_some(self, names: Sequence[str], positions: Sequence[float]) -> None:
        """Take positions in [rad] of some of the robot's joints; the other servos go on as they are told.

        A NaN stands for no command; one for no servo at all changes nothing.

        Raises:
            CommandError: unknown or repeated names, another number of positions, or an infinite one; nothing
                of it is used.
        """
        try:
            command = check_named_command(names, positions, self.joint_names)
        except CommandError as error:
            self.refuse(error)
            raise
        if command.keys().isdisjoint(self.servo_joints):
            return
        with self._lock:
            now = self._clock()
            told = {**dict(zip(self.servo_joints, self.motion.goal(now), strict=True)), **command}
            self.motion.command([told[name] for name in self.servo_joints], now)

    def refuse(self, error: CommandError) -> None:
        """Count a command that was refused."""
        self.counts.refused += 1
        self.counts.last_refusal = sentence(error)

    def tick(self) -> tuple[int, ...] | None:
        """Send the packet for now; call it once a period.

        Returns:
            The servo bytes that the board was told last; None where it was told no pose: standing by, in the
            board's quiet time, and while its pose is taken over.

        Raises:
            PortError: the port vanished or takes no data; the pose stays the last one sent.
        """
        with self._lock:
            latched = self.motion.e_stop.latched
            try:
                sent = self._tick(self._clock())
                self.sending = sent is not None
                return sent
            except PortError:
                self._end_course()
                raise
            finally:
                if latched:
                    self.motion.e_stop.heed()

    def begin_settling(self, timeout_s: float) -> bool:
        """Go to the rest pose at the limits' speed from the next tick on, then stand by.

        A latched e-stop ends it: nothing moves. When the way takes longer than `timeout_s` seconds, the
        servos brake and stay where they are by then.

        Returns:
            Whether there is a way to go; not without a port, nor for a board that was not told to move.
        """
        with self._lock:
            if self._transport is None or self.motion.e_stop.latched or not self._board_moved:
                self._end_course()
                return False
            self._course, self._rest_packets = "settle", 0
            self._settle_until = self._clock() + timeout_s
            self.settled.clear()
            return True

    def settle(self, timeout_s: float = 1.5, sent: Callable[[], None] = lambda: None) -> bool:
        """As `begin_settling`, but ticks itself and blocks until the end; `sent` is called after each packet.

        Returns:
            Whether the last packet was the rest pose.
        """
        if not self.begin_settling(timeout_s):
            return False
        try:
            while not self.settled.is_set():
                self._wait(self.period)
                self.tick()
                sent()
        except PortError:
            return False
        return self.arrived

    @property
    def arrived(self) -> bool:
        """Whether the newest way to rest ended there."""
        return self._rest_packets >= REST_REPEATS

    def hold_board(self) -> None:
        """Tell the board to stay where it is, where it can be told: for whoever finds the ticks ended."""
        with self._lock, contextlib.suppress(PortError):
            for _ in range(0 if self.waiting else REST_REPEATS):
                self._say(Ability.HOLD)

    def _tick(self, now: float) -> tuple[int, ...] | None:
        if self._transport is None or self.link is None:
            raise PortError("", "no port is open; configure the bridge first")
        self.link.check(now)
        stalled_s = 0.0 if self._last_tick is None else now - self._last_tick
        self._last_tick = now
        if self.link.state(now) == WAITING:
            self.motion.forget(now)
            return None
        if self.motion.e_stop.latched:
            if self._course == "settle":
                self._end_course()
            if self._say(Ability.HOLD):
                self._held = True
                self.counts.packets += 1
                return self.sent_bytes
        self._look_for_changes(now, stalled_s)
        if self._course == "idle" or not self._in_step(self._transport, self.link):
            return None
        return self._send(self._transport, self.link, now)

    def _look_for_changes(self, now: float, stalled_s: float) -> None:
        """Whether something happened after which the board's pose has to be asked for."""
        assert self.link is not None
        if self.link.take_restart():
            self.counts.restarts += 1
            self._lose_step("the board has started" if self._board_moved else "", now)
        elif self._held:
            self._held = False
            self.takeover.begin()
        elif self._course != "idle" and stalled_s > STALL_S:
            self._lose_step(f"the bridge stood still for {stalled_s:.1f} s", now)
        elif self._course != "idle" and not self.takeover.pending:
            with self.link.speaking() as board:
                deviation = board.deviation()
            if deviation:
                self._lose_step(f"the board {deviation}", now)

    def _lose_step(self, reason: str, now: float) -> None:
        self.motion.forget(now)
        self.takeover.begin(reason)

    def _in_step(self, transport: SerialTransport, link: BoardLink) -> bool:
        """Whether the board's pose is known; else it is asked for."""
        if not self.takeover.pending:
            return True
        with link.speaking() as board:
            packet = self.takeover.ask(board)
            if not packet:
                self._take_pose(board)
                return True
        transport.write(packet)
        return False

    def _take_pose(self, board: BoardProtocol) -> None:
        """Go on from the pose that the board says it has; where it says none, from the last one sent."""
        self.motion.top_speed = board.top_speed
        pose = board.pose()
        if pose is None:
            return
        before = self.motion.positions
        self.motion.resume_from(check_command(pose, self.servo_joints))
        away = max(abs(one - other) for one, other in zip(before, self.motion.positions, strict=True))
        if away > SAME_POSE and self._board_moved:
            degrees = ", ".join(f"{math.degrees(each):.1f}" for each in self.motion.positions)
            self.takeover.news.append(
                f"the board stands {math.degrees(away):.0f} deg away from what it was told; the bridge goes"
                f" on from there ({degrees} deg)"
            )

    def _send(self, transport: SerialTransport, link: BoardLink, now: float) -> tuple[int, ...]:
        """Write the next pose of the present course."""
        before, settling = self.motion.positions, self._course == "settle"
        late = settling and now >= self._settle_until
        step = self.motion.brake if late else self.motion.step_to_rest if settling else self.motion.step
        positions = step(now)
        try:
            with link.speaking() as board:
                board.avoid_byte_100 = self.avoid_byte_100
                packet = board.encode(positions)
            transport.write(packet.data)
        except PortError:
            self.motion.resume_from(before)
            raise
        self.counts.packets += 1
        self.counts.avoided += packet.avoided
        self._board_moved = True
        self.sent_bytes, self._applied = packet.servo_bytes, packet.angles_rad
        if settling:
            self._rest_packets += self.motion.at_rest
            if self.arrived or (late and self.motion.standing):
                self._end_course()
        return packet.servo_bytes

    def _end_course(self) -> None:
        self._course, self.sending = "idle", False
        self.settled.set()

    def applied_angles(self) -> tuple[float, ...]:
        """Nominal joint angles in [rad] of what was last sent, in servo order; NaN before the first."""
        return self._applied


def _period(robot: str, rate: float) -> float:
    if not SLOWEST_HZ <= rate <= FASTEST_HZ:  # also refuses NaN
        raise SceneError(
            f"robot {robot}: {rate:g} packets a second refused; allowed are"
            f" {SLOWEST_HZ:g} to {FASTEST_HZ:g} Hz"
        )
    return 1.0 / rate
