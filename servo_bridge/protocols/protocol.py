"""The protocol of a board: how targets become bytes, and what the bytes that come back mean.

A protocol is one class derived from `BoardProtocol`; an object of it is one conversation with one board, made
anew whenever the port is opened. It does no I/O and reads no clock: the driver asks it for bytes and writes
them, the link hands it what the port gave. Limits, ramps, hold, rest and the e-stop lie before it (`safety`),
so a protocol gets finite angles within the servos' limits.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Flag
from typing import ClassVar, final

from softsim_core.base.errors import CommandError
from softsim_core.scene.board import BoardDescription, Servo, ServoCalibration


class Ability(Flag):
    """What a board of a protocol can do beyond taking poses.

    DETECT: soon after its port was opened it says unasked what no other board says. `auto` finds the built-in
        ones by that; where the protocol is named, a board that does not say it is refused.
    TELEMETRY: it keeps talking unasked; 0.5 s of silence is a lost board.
    IMU: it reports tilts.
    ASKED: it speaks only when it is asked, and is: as soon as its port is open, and then all the time. Only
        where the robot's servos or a name leave no other protocol.
    HOLD: it can be told to stay where it is, as while the e-stop is latched.
    RELAX: it can be told to switch its pulses off.
    LIMITS: it has to be told something before its pose is taken over: ranges that it keeps, or to get ready.
    MEASURES: its servos tell where they stand, as measured: that is published, and not what they were told.
    REST: it goes to its rest pose by itself where nothing comes any more.
    """

    DETECT = 1
    TELEMETRY = 2
    IMU = 4
    HOLD = 8
    RELAX = 16
    LIMITS = 32
    REST = 64
    ASKED = 128
    MEASURES = 256


@dataclass(frozen=True, slots=True)
class TiltReading:
    """Tilts that an IMU measures, in [rad].

    Attributes:
        tilt_x: Rotation about x.
        tilt_y: Rotation about y.
    """

    tilt_x: float
    tilt_y: float

    def quaternion_xyzw(self) -> tuple[float, float, float, float]:
        """Orientation Rx(tilt_x) Ry(tilt_y); the heading, which is not measured, is 0."""
        sin_x, cos_x = math.sin(self.tilt_x / 2.0), math.cos(self.tilt_x / 2.0)
        sin_y, cos_y = math.sin(self.tilt_y / 2.0), math.cos(self.tilt_y / 2.0)
        return (sin_x * cos_y, cos_x * sin_y, sin_x * sin_y, cos_x * cos_y)


@dataclass(frozen=True, slots=True)
class EncodedPacket:
    """A pose as bytes, and what the servos are really told by them.

    Attributes:
        data: Bytes for one write.
        servo_bytes: Degrees of hobby servos, in packet order, rounded where the packet is finer; pulses of
            servos on a bus.
        angles_rad: Nominal joint angles of what the packet says, in [rad], in packet order.
        avoided: Whether a byte 100 was replaced.
    """

    data: bytes
    servo_bytes: tuple[int, ...]
    angles_rad: tuple[float, ...]
    avoided: bool = False


@dataclass(frozen=True, slots=True)
class Decoded:
    """What some bytes of a board meant.

    Attributes:
        recognised: Among them was a whole message that only a board of this protocol sends unasked.
        restarted: The board says that it has just started, and so forgot its pose and ranges.
        tilts: Readings of its IMU, oldest first.
    """

    recognised: bool = False
    restarted: bool = False
    tilts: tuple[TiltReading, ...] = ()


class BoardModel(ABC):
    """The board's end of the line, without hardware: what a virtual board has behind its port.

    Times are seconds of any steady clock.

    Attributes:
        say_period_s: How often it speaks unasked, in [s]; None: only in answer to what it is fed.
        largest: Largest number of a pose: degrees, or pulses.
    """

    say_period_s: float | None = None
    largest: int = 180

    @property
    @abstractmethod
    def accepted(self) -> int:
        """Poses accepted since it was made."""

    @property
    @abstractmethod
    def dropped(self) -> int:
        """Packets dropped or refused since it was made."""

    @abstractmethod
    def feed(self, data: bytes, now: float) -> list[tuple[int, ...]]:
        """Take bytes; the poses accepted among them as `EncodedPacket.servo_bytes` has them, oldest first."""

    @abstractmethod
    def reset(self, cause: int) -> None:
        """Start anew, as when the port is opened.

        Args:
            cause: Bits of an Uno's reset cause: 1 power-on, 2 external, 4 brown-out, 8 watchdog.
        """

    def say(self, now: float) -> bytes:
        """What the board says now; called at its period, or after `feed`."""
        return b""

    def answer(self, now: float) -> bytes:
        """What the board says at once to what it was fed."""
        return self.say(now) if self.say_period_s is None else b""

    def advance(self, now: float) -> None:
        """Let time pass, where nobody listens; nothing to do for a board that does not move by itself."""
        return

    @property
    def widths_us(self) -> tuple[float, ...] | None:
        """Pulse widths in [us] that the servos have reached; None without pulses, or where not modelled."""
        return None


class BoardProtocol(ABC):
    """One conversation with one board; a subclass names itself and defines at least `encode_pose`.

    The link makes sure that no two methods of an object run at a time. Methods of abilities that the class
    does not name are never called. What a method raises counts as a failed port: the servos keep their last
    pose, and the port is opened anew.

    Args:
        board: The robot's board; its servos give number and order of the angles.

    Attributes:
        servos: The board's hobby servos.
        joints: Joint of each servo.
        name: Word for the parameter `protocol` and for a robot's board settings.
        drives: Kind of servos that such a board drives.
        abilities: What such a board can do.
        baud_rate: Bits a second of all boards of this protocol; None: as the robot's board settings say.
        advice: What to do where no such board answers, for messages.
        top_speed: Largest speed in [rad/s] with which such a board moves a servo; it is told none faster.
        avoid_byte_100: The byte 100 shall not be sent where it can be helped: coming first after a reset amid
            a packet it makes the boot loader of an Uno erase the firmware. Set before every `encode`.
    """

    name: ClassVar[str]
    drives: ClassVar[type] = ServoCalibration
    abilities: ClassVar[Ability] = Ability(0)
    baud_rate: ClassVar[int | None] = None
    advice: ClassVar[str] = "check which board it is, or set the parameter protocol to auto"
    top_speed: float = math.inf

    def __init__(self, board: BoardDescription) -> None:
        self.board, self.servos = board, board.hobby_servos
        self.joints = tuple(servo.joint for servo in board.servos)
        self.avoid_byte_100 = True

    @classmethod
    def refusal(cls, board: BoardDescription) -> str:
        """Why a board with such servos cannot be driven in this protocol; empty where it can."""
        return ""

    @classmethod
    def board_model(cls, servos: Sequence[Servo]) -> BoardModel | None:
        """A board of this protocol without hardware, for tests and demos; None where there is no model."""
        return None

    @final
    def encode(self, angles_rad: Sequence[float]) -> EncodedPacket:
        """A pose as one packet.

        Args:
            angles_rad: Joint angles in [rad], one per servo in the order of the board's servos.

        Raises:
            CommandError: wrong number of angles, or one that is not finite; nothing is encoded.
        """
        if len(angles_rad) != len(self.joints):
            raise CommandError(
                f"packet of {len(angles_rad)} angles refused: the board has {len(self.joints)} servos"
                f" ({', '.join(self.joints)})"
            )
        for angle, joint in zip(angles_rad, self.joints, strict=True):
            if not math.isfinite(angle):
                raise CommandError(
                    f"angle {angle} for joint {joint} refused: expected a finite number of radians"
                )
        return self.encode_pose(angles_rad)

    @abstractmethod
    def encode_pose(self, angles_rad: Sequence[float]) -> EncodedPacket:
        """The packet of a pose that `encode` has checked; angles beyond a servo's range are clipped to it."""

    def decode(self, data: bytes) -> Decoded:
        """Take what the port gave, which may be nothing, damaged, cut anywhere, or of another protocol."""
        return Decoded()

    @property
    def ready(self) -> bool:
        """Whether a board that was recognised may be written to; it is waited for until then."""
        return True

    def fault(self) -> str:
        """Why the board that was recognised cannot be driven, as "speaks version 2 ..."; empty: it can."""
        return ""

    def ask(self) -> bytes:
        """Packet that asks the board what is to be known of it next; it moves nothing. Empty: nothing is.

        Sent whenever it is time for a packet and no other is sent; to a board that was not recognised yet
        only with ability ASKED.
        """
        return b""

    def identity(self) -> str | None:
        """What tells this board from others of its kind, and outlasts a loss of its power.

        A board that comes back after its port was lost is driven on only where it says the same.

        Returns:
            None as long as the board has not said it; empty where it says nothing of the kind.
        """
        return ""

    def begin_takeover(self) -> None:
        """The board's pose is not known any more: what it said so far does not count as an answer."""
        return

    def limits(self) -> bytes:
        """Packet that tells the board the ranges of its servos, or to get ready (ability LIMITS).

        Sent when the board (re)started, and before its pose is taken over: again until `acknowledged`.
        """
        return b""

    def acknowledged(self) -> bool:
        """Whether the board says that it has taken what `limits` gave since `begin_takeover`."""
        return True

    def pose(self) -> Sequence[float] | None:
        """Joint angles in [rad] at which the board stands; None where it has no pulses."""
        return None

    def measured(self) -> Sequence[float] | None:
        """Joint angles in [rad] as the servos measured last (ability MEASURES); None before the first."""
        return None

    def deviation(self) -> str:
        """What the board does other than it was told, as "stands still ..."; empty: it does as told."""
        return ""

    def hold(self) -> bytes:
        """Packet that makes the board stay where it is (ability HOLD); sent while the e-stop is latched."""
        return b""

    def relax(self) -> bytes:
        """Packet that switches the pulses off (ability RELAX); sent when the port is closed at rest."""
        return b""

    def values(self) -> Mapping[str, object]:
        """What the board said last, by name with unit, for /diagnostics."""
        return {}
