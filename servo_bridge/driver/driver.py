"""From commands to packets on a port: motion, protocol and port of one board. The clock is an argument.

Two threads may use a driver: one ticks, the other gives commands. The e-stop needs neither: it is a latch
that every tick checks first. A port or a protocol that hangs blocks the ticks, and no other caller.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from typing import Literal, TypeAlias

from servo_bridge import PortError, ProtocolError
from servo_bridge.driver.link import BoardLink, MetBoard, Reader
from servo_bridge.driver.ports import Opener, Transport, open_transport
from servo_bridge.driver.safety import EStop, MotionSettings, ServoMotion, rest_angle, servo_limits
from servo_bridge.driver.servo import within
from servo_bridge.driver.takeover import Takeover
from servo_bridge.driver.writer import run_with_timeout
from servo_bridge.protocols import AUTO, WAITING, Ability, TiltReading, candidates
from softsim_core.base import CommandError, SceneError
from softsim_core.physics.mechanics import JointLimits, check_command, check_named_command
from softsim_core.scene import BoardDescription, BusServo, RobotDescription, Servo
from softsim_node import error_text, list_names

# Number of repetitions of the last packets, since one lost byte must not decide where the servos stop
REST_REPEATS = 3
PoselessPacket: TypeAlias = Literal[Ability.HOLD, Ability.RELAX]
Mode: TypeAlias = Literal["listen", "follow", "settle"]  # in "listen" no pose is sent

# Limits of packets per second. Below, a board takes the pauses for silence; above, the line is full.
SLOWEST_HZ, FASTEST_HZ = 10.0, 200.0


def steady_time() -> float:
    """Return the time in [s] of a steady clock that also counts while the computer is suspended."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


@dataclass(slots=True)
class DriverCounts:
    """Counters of a driver since it was created."""

    packets: int = 0  # packets written
    refused: int = 0  # commands that were refused as a whole
    last_refusal: str = ""  # message of the newest refusal
    avoided: int = 0  # packets in which a byte 100 was replaced
    restarts: int = 0  # number of times that a board identified itself, at first or after a reset


class ServoDriver:
    """Sends the newest command to the board, through limits and ramps, one packet per tick.

    Args:
        robot: Description with a board; its joints give names, order and limits.
        settings: Timing of hold and rest.
        rate: Packets per second in [Hz]; None takes the board's.
        avoid_byte_100: Send no byte 100 if the protocol can avoid it; see `BoardProtocol`.
        protocol: Name of the board's protocol; "auto" takes the one of the robot's board, else detects it,
            see `link`.
        baud_rate: Bits per second; None takes the protocol's own if it has one, else the board's.
        on_tilt: Called in the reading thread with every reading of a board's IMU.
        e_stop: The latch that every tick checks; None creates one.
        clock: Steady clock in [s].
        wait: Sleeps for a time in [s]; used only by `settle`.
        open_port: Opens a port by its name and baud rate.

    Attributes:
        clock: The clock.
        link: State of the open port; None without one.
        motion: The motion that the servos are commanded.
        takeover: Whether and why the board has to be asked for its pose before a pose is sent.
        settled: Set while the servos are not settling.
        sent_bytes: Servo bytes sent last; None before the first.

    Raises:
        SceneError: the robot has no board; the protocol is unknown or does not fit its servos; the rest byte
            of a servo lies outside its limits; or the rate is not allowed.
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
        open_port: Opener = open_transport,
    ) -> None:
        if robot.board is None or not robot.board.servos:
            raise SceneError(
                f"robot {robot.name} has no servo board; add a section board to {robot.source or 'it'}"
            )
        rate = rate or robot.board.rate
        if not SLOWEST_HZ <= rate <= FASTEST_HZ:  # also refuses NaN
            raise SceneError(
                f"robot {robot.name}: {rate:g} packets a second refused; allowed are"
                f" {SLOWEST_HZ:g} to {FASTEST_HZ:g} Hz"
            )
        self.period = 1.0 / rate
        board = _board(robot, robot.board, 1.0 / self.period, baud_rate or robot.board.baud_rate)
        try:
            protocols = candidates(protocol, board)
        except ProtocolError as error:
            raise SceneError(f"robot {robot.name}: {error}") from error
        self.board, self.servos = board, board.servos
        self.baud_rate = baud_rate or protocols[-1].baud_rate or board.baud_rate
        self.link: BoardLink | None = None
        self._candidates, self._on_tilt = protocols, on_tilt
        self._transport: Transport | None = None
        self._reader: Reader | None = None
        self._met: MetBoard | None = None  # of a port that is closed again
        self.clock, self._wait, self._open_port = clock, wait, open_port
        self.protocol = protocols[0].name if len(protocols) == 1 else AUTO
        self.may_speak = any(Ability.DETECT in each.abilities for each in protocols)
        self.servo_joints = tuple(servo.joint for servo in self.servos)
        self._joint_names = robot.joint_names
        self._travels = tuple(_travel_of(servo) for servo in self.servos)
        limits = {servo.joint: _angle_limits(robot, servo) for servo in self.servos}
        self.motion = ServoMotion(
            self.servo_joints,
            [servo_limits(servo, limits[servo.joint]) for servo in self.servos],
            [rest_angle(servo) for servo in self.servos],
            e_stop=e_stop,
        )
        self._lock = threading.RLock()
        self.set_timing(settings or MotionSettings())
        self.avoid_byte_100 = avoid_byte_100
        self.counts = DriverCounts()
        self._mode: Mode = "follow"
        self.settled = threading.Event()
        self.settled.set()
        self._settle_until = 0.0
        self._rest_packets = 0  # sent at the end of settling
        self.takeover = Takeover(self.motion, self._lock)
        self._has_sent = False  # the last tick sent a pose, or the command to hold
        self.sent_bytes: tuple[int, ...] | None = None
        self._applied: tuple[float, ...] = (math.nan,) * len(self.servos)

    @property
    def met(self) -> MetBoard | None:
        """Board accepted since `connect`, or before it with `again`; None before the first."""
        return self._met if self.link is None else self.link.met

    @property
    def port(self) -> str:
        """Name of the open port; empty without one."""
        return "" if self._transport is None else self._transport.port

    @property
    def connected(self) -> bool:
        """Whether a port is open."""
        return self._transport is not None

    @property
    def waiting(self) -> bool:
        """Whether the quiet time after the opening of the port still runs."""
        return self.link_state == WAITING

    @property
    def link_state(self) -> str | None:
        """Name of the protocol in use, or WAITING while it is not known yet; None without a port."""
        return None if self.link is None else self.link.state(self.clock())

    @property
    def holds(self) -> bool | None:
        """Whether the board has the ability HOLD; None while that is not known."""
        link = self.link
        return None if link is None or self.waiting else Ability.HOLD in link.board.abilities

    @property
    def telemetry_age(self) -> float | None:
        """Time in [s] since the newest message that identifies the protocol; None before the first."""
        return None if self.link is None else self.link.telemetry_age(self.clock())

    def listen(self) -> None:
        """Check the board without writing to it; raise PortError if it is lost or not the one asked for."""
        if self.link is not None:
            self.link.check(self.clock())

    @property
    def command_age(self) -> float | None:
        """Time in [s] since the newest accepted command; None before the first."""
        return self.motion.command_age(self.clock())

    @property
    def sending(self) -> bool:
        """Whether the last tick sent the board a pose, or the command to hold."""
        return self._has_sent and self.connected

    @property
    def moved(self) -> bool:
        """Whether a pose was sent to the board since `connect`."""
        return self.takeover.moved

    def set_timing(self, settings: MotionSettings) -> None:
        """Apply new hold and rest times at once; the longest step stays two periods."""
        with self._lock:
            self.motion.settings = replace(settings, longest_step_s=2.0 * self.period)

    def connect(
        self, port: str, quiet_s: float = 0.0, *, again: bool = False, silent_allowed: bool = True
    ) -> None:
        """Open the port; the ticks send once the board has reported, or after a quiet time.

        Args:
            port: Name of the port.
            quiet_s: Quiet time in [s] after the opening; nothing is written in it unless the board sends
                first.
            again: Drive only the board that was accepted before: `tick` refuses a board with another
                identity, and refuses silence if that board has an identity.
            silent_allowed: Drive a board that sends nothing, in a protocol of such boards; else `tick`
                refuses it.

        Raises:
            PortError: the port cannot be opened.
        """
        self.disconnect()
        transport = self._open_port(port, self.baud_rate)
        with self._lock:
            boards = [each(self.board) for each in self._candidates]
            before = self._met if again else None
            self.link = BoardLink(transport.port, boards, quiet_s, self.clock(), before, silent_allowed)
            self._transport = transport
            self._reader = Reader(transport, self.link, self.clock, self._on_tilt)
            self._mode = "follow"
            self.takeover.record_opening()

    def disconnect(self, *, relax: bool = False) -> None:
        """Close the port if one is open; the last pose sent stays known.

        `relax`: switch the pulses off first, if the board can and its servos are at rest.
        """
        with self._lock:
            packets: Sequence[PoselessPacket] = ()
            if self.motion.e_stop.latched:
                packets = self._holds()
            elif relax and self.takeover.moved and self.motion.at_rest and not self.waiting:
                packets = (Ability.RELAX,)
            self._met = self.met
            reader, self._reader = self._reader, None
            transport, self._transport = self._transport, None
            link, self.link = self.link, None
            self._stop_sending()

        def close() -> None:
            """Send the last packets and close; blocks for as long as the port or the protocol does."""
            if transport is not None and link is not None:
                with contextlib.suppress(PortError):
                    for packet_kind in packets:
                        _send(transport, link, packet_kind)
            if reader is not None:
                reader.stop()
            if transport is not None:
                transport.close()

        run_with_timeout(close)

    def start(self) -> None:
        """Start to send from the board's pose, else from the last one sent (at first the rest pose).

        Earlier commands do not count.
        """
        with self._lock:
            self.motion.start(self.clock())
            self.takeover.start()
            self._mode = "follow"

    def stand_by(self) -> None:
        """Only listen from now on; while the e-stop is latched, ticks still send hold to a board that can."""
        with self._lock:
            self._stop_sending()

    def command(self, values: Sequence[float]) -> None:
        """Accept one position in [rad] per joint of the robot, in the robot's order.

        Raises:
            CommandError: wrong length or a value that is not finite; nothing of it is used.
        """
        with self._counting_refusals():
            checked = dict(zip(self._joint_names, check_command(values, self._joint_names), strict=True))
            self._command([checked[name] for name in self.servo_joints])

    def command_named(self, positions: Mapping[str, float]) -> None:
        """Accept positions in [rad] by joint name; names that drive no servo are ignored.

        Raises:
            CommandError: a servo's joint is missing, or its value is not finite; nothing of it is used.
        """
        with self._counting_refusals():
            missing = [name for name in self.servo_joints if name not in positions]
            if missing:
                raise CommandError(
                    f"joint states without {list_names(missing)} refused; they name {list_names(positions)};"
                    " nothing was moved"
                )
            self._command(check_command([positions[name] for name in self.servo_joints], self.servo_joints))

    def command_some(self, names: Sequence[str], positions: Sequence[float]) -> None:
        """Accept positions in [rad] of some of the robot's joints; other servos keep their targets.

        A NaN means no command. A command without any servo changes nothing.

        Raises:
            CommandError: unknown or repeated names, another number of positions, or an infinite one; nothing
                of it is used.
        """
        with self._counting_refusals():
            command = check_named_command(names, positions, self._joint_names)
            if command.keys().isdisjoint(self.servo_joints):
                return
            with self._lock:
                now = self.clock()
                goals = zip(self.servo_joints, self.motion.goal(now), self._travels, strict=True)
                angles = [command[name] / travel if name in command else goal for name, goal, travel in goals]
                self.motion.command(angles, now)

    def _command(self, positions: Sequence[float]) -> None:
        with self._lock:
            angles = [each / travel for each, travel in zip(positions, self._travels, strict=True)]
            self.motion.command(angles, self.clock())

    def refuse(self, error: CommandError) -> None:
        """Count a refused command and store its message."""
        self.counts.refused += 1
        self.counts.last_refusal = error_text(error)

    @contextlib.contextmanager
    def _counting_refusals(self) -> Iterator[None]:
        try:
            yield
        except CommandError as error:
            self.refuse(error)
            raise

    def tick(self) -> tuple[int, ...] | None:
        """Send the packet for now; call it once per period.

        Returns:
            The servo bytes sent last; None if no pose applies: while only listening, in the board's quiet
            time, and during a takeover.

        Raises:
            PortError: the port vanished or takes no data; the pose stays the last one sent.
        """
        latched = self.motion.e_stop.latched
        try:
            sent = self._tick(self.clock())
            self._has_sent = sent is not None
            return sent
        except PortError:
            self._stop_sending()
            raise
        finally:
            if latched:  # also after an error: then there is nothing left to send
                self.motion.e_stop.acknowledge()

    def begin_settling(self, timeout_s: float) -> bool:
        """Move to the rest pose at the limits' speed from the next tick on, then only listen.

        A latched e-stop ends the move. If the move takes longer than `timeout_s` seconds, the servos brake
        and stop on the way.

        Returns:
            Whether a move has begun; False without a port, and for a board that was never sent a pose.
        """
        with self._lock:
            if self._transport is None or self.motion.e_stop.latched or not self.takeover.moved:
                self._stop_sending()
                return False
            self._mode, self._rest_packets = "settle", 0
            self._settle_until = self.clock() + timeout_s
            self.settled.clear()
            return True

    def settle(self, timeout_s: float = 1.5, sent: Callable[[], None] = lambda: None) -> bool:
        """Settle like `begin_settling`, but tick here until the end, calling `sent` after each packet.

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
        """Whether the newest settling ended at the rest pose."""
        return self._rest_packets >= REST_REPEATS

    def hold_board(self) -> None:
        """Command the board to hold, if it can; for a caller that finds the ticks ended."""
        packets = self._holds()
        run_with_timeout(lambda: [self._say(each) for each in packets])

    def _tick(self, now: float) -> tuple[int, ...] | None:
        transport, link = self._transport, self.link
        if transport is None or link is None:
            raise PortError("", "no port is open; configure the bridge first")
        link.check(now)
        stalled_s = self.takeover.passed_s(now)
        if link.state(now) == WAITING:
            with self._lock:
                self.motion.forget(now)  # commands given in the quiet time do not count
            self._ask()
            return None
        if self.motion.e_stop.latched:
            if self._mode == "settle":
                self._stop_sending()
            if self._say(Ability.HOLD):
                self.takeover.hold_sent = True
                self.counts.packets += 1
                return self.sent_bytes
        restarted, listens = link.take_restart(), self._mode == "listen"
        self.counts.restarts += restarted
        self.takeover.look(link, now, stalled_s, restarted=restarted, listens=listens)
        if listens:
            self._ask()
            return None
        if question := self.takeover.question(link):
            transport.write(question)
            return None
        return self._send(transport, link, now)

    def _send(self, transport: Transport, link: BoardLink, now: float) -> tuple[int, ...]:
        """Write the next pose of the present mode."""
        with self._lock:
            before = self.motion.positions
            if self._mode != "settle":
                positions = self.motion.step(now)
            elif now >= self._settle_until:
                positions = self.motion.brake(now)
            else:
                positions = self.motion.step_to_rest(now)
        try:
            with link.speaking() as board:
                board.avoid_byte_100 = self.avoid_byte_100
                packet = board.encode(positions, self.motion.limits)
                measured = board.measured() if Ability.MEASURES in board.abilities else None
            transport.write(packet.data)
        except PortError:
            with self._lock:
                self.motion.resume_from(before)
            raise
        self.counts.packets += 1
        self.counts.avoided += packet.avoided
        self.takeover.moved = True
        self.sent_bytes = packet.servo_bytes
        angles = packet.angles_rad if measured is None else measured
        self._applied = tuple(each * travel for each, travel in zip(angles, self._travels, strict=True))
        with self._lock:
            if self._mode == "settle":  # ends at rest, or, when its time is over, where the servos stop
                self._rest_packets += self.motion.at_rest
                if self.arrived or (now >= self._settle_until and self.motion.standing):
                    self._stop_sending()
        return packet.servo_bytes

    def _holds(self) -> Sequence[PoselessPacket]:
        hold: PoselessPacket = Ability.HOLD
        return () if self.waiting else (hold,) * REST_REPEATS

    def _say(self, packet_kind: PoselessPacket) -> bool:
        """Send a packet without a pose; return False, with nothing sent, if the board lacks the ability."""
        transport, link = self._transport, self.link
        return transport is not None and link is not None and _send(transport, link, packet_kind)

    def _ask(self) -> None:
        """Send the next query of the protocol, if there is one and the board may be queried."""
        transport, link = self._transport, self.link
        if transport is None or link is None:
            return
        with link.speaking() as board:
            question = board.ask() if link.asks else b""
        if question:
            transport.write(question)

    def _stop_sending(self) -> None:
        self._mode = "listen"
        self.settled.set()
        self._has_sent = False

    def applied_angles(self) -> tuple[float, ...]:
        """Return joint positions in servo order, measured if servos measure, else sent; NaN first.

        They are in [rad], or in [m] where a servo winds a cable.
        """
        return self._applied


def _board(robot: RobotDescription, board: BoardDescription, rate: float, baud_rate: int) -> BoardDescription:
    """Return the board as it is used: the ranges of bus servos narrowed to the limits of their joints."""
    joints = {joint.name: joint for joint in robot.joints}
    for servo in board.servos:
        joint = joints[servo.joint]
        winds = joint.kind == "cable" and not joint.by_effort and _travel_of(servo) != 1.0
        if joint.kind != "revolute" and not winds:
            raise SceneError(
                f"robot {robot.name}: joint {servo.joint} of a servo must be revolute, or a cable that is"
                " commanded by displacement, on a bus servo with `travel`"
            )
    servos = tuple(
        within(servo, _angle_limits(robot, servo)) if isinstance(servo, BusServo) else servo
        for servo in board.servos
    )
    return replace(board, servos=servos, rate=rate, baud_rate=baud_rate)


def _send(transport: Transport, link: BoardLink, packet_kind: PoselessPacket) -> bool:
    """Send a packet without a pose; return False, with nothing sent, if the board lacks the ability."""
    with link.speaking() as board:
        if packet_kind not in board.abilities:
            return False
        packet = board.hold() if packet_kind is Ability.HOLD else board.relax()
    transport.write(packet)
    return True


def _travel_of(servo: Servo) -> float:
    """Return the travel of a servo's joint per [rad] of the servo, in [rad] or [m]."""
    return servo.travel if isinstance(servo, BusServo) else 1.0


def _angle_limits(robot: RobotDescription, servo: Servo) -> JointLimits:
    """Return the limits of a servo's joint as limits of the servo's angle in [rad]."""
    limits = next(joint.limits for joint in robot.joints if joint.name == servo.joint)
    return JointLimits(*(each / _travel_of(servo) for each in astuple(limits)))
