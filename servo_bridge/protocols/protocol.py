"""The protocol of a board: how targets become bytes, and what the received bytes mean.

A protocol is one class derived from `BoardProtocol`. An object of it serves one board on one open port and is
created again whenever the port is opened. It does no I/O and reads no clock: the driver requests bytes from
it and writes them, the link passes received bytes to it. Limits, ramps, hold, rest and the e-stop are applied
before it (`safety`), so a protocol receives finite angles within the servos' limits.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Flag
from typing import ClassVar, final

from softsim_core.base import CommandError
from softsim_core.physics.mechanics import JointLimits, check_command
from softsim_core.scene import BoardDescription, Servo, ServoCalibration


class Ability(Flag):
    """What a board of a protocol can do beyond taking poses.

    DETECT: soon after its port was opened it sends, without a request, what no other board sends. `auto`
        detects the built-in ones by that; if the protocol is named, a board that does not send it is refused.
    TELEMETRY: it sends without a request; after 0.5 s of silence it is lost.
    IMU: it reports tilts.
    ASKED: it sends only when it is asked, and is asked as soon as its port is open, and then all the time.
        Only used if the robot's servos or a name leave no other protocol.
    HOLD: it can be commanded to hold, which is used while the e-stop is latched.
    RELAX: it can be commanded to switch its pulses off.
    LIMITS: it needs a packet before its pose is taken over: ranges to store, or the command to get ready.
    MEASURES: its servos measure their positions, which are published instead of the commanded ones.
    REST: it moves to its rest pose by itself when no packets arrive.
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
    """Tilts measured by an IMU: rotations about x and about y in [rad]."""

    tilt_x: float
    tilt_y: float

    def quaternion_xyzw(self) -> tuple[float, float, float, float]:
        """Return the orientation Rx(tilt_x) Ry(tilt_y); the heading, which is not measured, is 0."""
        sin_x, cos_x = math.sin(self.tilt_x / 2.0), math.cos(self.tilt_x / 2.0)
        sin_y, cos_y = math.sin(self.tilt_y / 2.0), math.cos(self.tilt_y / 2.0)
        return (sin_x * cos_y, cos_x * sin_y, sin_x * sin_y, cos_x * cos_y)


@dataclass(frozen=True, slots=True)
class EncodedPacket:
    """A pose as bytes, and the servo commands that the bytes really carry.

    Attributes:
        data: Bytes for one write.
        servo_bytes: Degrees of hobby servos, in packet order, rounded if the packet is finer; pulses of
            servos on a bus.
        angles_rad: Nominal joint angles that the packet encodes, in [rad], in packet order.
        avoided: Whether a byte 100 was replaced.
    """

    data: bytes
    servo_bytes: tuple[int, ...]
    angles_rad: tuple[float, ...]
    avoided: bool = False


@dataclass(frozen=True, slots=True)
class Decoded:
    """Content of some received bytes.

    Attributes:
        recognised: Whether they contain a whole message that only a board of this protocol sends without a
            request.
        restarted: Whether the board reports that it has just started, and so has lost its pose and ranges.
        tilts: Readings of its IMU, oldest first.
    """

    recognised: bool = False
    restarted: bool = False
    tilts: tuple[TiltReading, ...] = ()


class BoardModel(ABC):
    """The board's end of the line, without hardware: the model behind the port of a virtual board.

    Times are seconds of any steady clock.

    Attributes:
        say_period_s: Period in [s] at which it sends without a request; None: it sends only responses.
        largest: Largest value in a pose: degrees, or pulses.
    """

    say_period_s: float | None = None
    largest: int = 180

    @property
    @abstractmethod
    def accepted(self) -> int:
        """Number of poses accepted since its creation."""

    @property
    @abstractmethod
    def dropped(self) -> int:
        """Number of packets dropped or refused since its creation."""

    @abstractmethod
    def feed(self, data: bytes, now: float) -> list[tuple[int, ...]]:
        """Process bytes; return the accepted poses, like `EncodedPacket.servo_bytes`, oldest first."""

    @abstractmethod
    def reset(self, cause: int) -> None:
        """Restart, as when the port is opened.

        The cause has the bits of an Uno's: 1 power-on, 2 external, 4 brown-out, 8 watchdog.
        """

    def say(self, now: float) -> bytes:
        """Return what the board sends now; called at its period, or after `feed`."""
        return b""

    def answer(self, now: float) -> bytes:
        """Return what the board sends at once in response to `feed`."""
        return self.say(now) if self.say_period_s is None else b""

    def advance(self, now: float) -> None:
        """Advance to `now` while nothing is received; a board that does not move does nothing."""
        return

    @property
    def widths_us(self) -> tuple[float, ...] | None:
        """Pulse widths in [us] that the servos have reached; None without pulses, or if not modelled."""
        return None


class BoardProtocol(ABC):
    """One board on one open port; a subclass sets its name and defines at least `encode_pose`.

    The link ensures that no two methods of an object run at the same time. Methods of abilities that the
    class does not name are never called. An exception in a method counts as a failed port: the servos stay at
    their last pose, and the port is opened again.

    Args:
        board: The robot's board; its servos give number and order of the angles.

    Attributes:
        servos: The board's hobby servos.
        joints: Joint of each servo.
        name: Name for the parameter `protocol` and for a robot's board settings.
        drives: Type of the servos that such a board drives.
        abilities: What such a board can do.
        baud_rate: Bits per second of all boards of this protocol; None takes the one of the robot's board
            settings.
        advice: What to do if no such board responds, for messages.
        top_speed: Largest speed in [rad/s] with which such a board moves a servo; commands are not faster.
        avoid_byte_100: Whether to avoid the byte 100 if possible: as the first byte after a reset in the
            middle of a packet, it makes the boot loader of an Uno erase the firmware. Set before every
            `encode`.
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
        """Return why a board with these servos cannot be driven in this protocol; empty if it can."""
        return ""

    @classmethod
    def board_model(cls, servos: Sequence[Servo]) -> BoardModel | None:
        """Return a model of a board of this protocol, for tests and demos; None if there is none."""
        return None

    @final
    def encode(self, angles_rad: Sequence[float], limits: Sequence[JointLimits] = ()) -> EncodedPacket:
        """Encode a pose as one packet, after the last check before the hardware.

        Args:
            angles_rad: Joint angles in [rad], one per servo in the order of the board's servos.
            limits: Allowed angles of each servo; empty: only the servos' ranges, to which angles are clipped.

        Raises:
            CommandError: wrong number of angles, or one that is not finite or beyond the limits; nothing is
                encoded.
        """
        # Commands were checked and clamped long before. This check holds alone if code in between is wrong.
        angles = check_command(angles_rad, self.joints)
        for joint, angle, allowed in zip(self.joints, angles, limits, strict=bool(limits)):
            if not allowed.allows(angle):
                raise CommandError(
                    f"angle {angle} for joint {joint} refused: allowed is [{allowed.lower}, {allowed.upper}]"
                )
        return self.encode_pose(angles)

    @abstractmethod
    def encode_pose(self, angles_rad: Sequence[float]) -> EncodedPacket:
        """Encode a pose that `encode` has checked; clip angles to the ranges of the servos."""

    def decode(self, data: bytes) -> Decoded:
        """Process what the port returned: nothing, or bytes that may be damaged, cut, or foreign."""
        return Decoded()

    @property
    def ready(self) -> bool:
        """Whether a recognised board may be written to; until then the bridge waits."""
        return True

    def fault(self) -> str:
        """Return why a recognised board cannot be driven, as "speaks version 2 ..."; empty if it can."""
        return ""

    def ask(self) -> bytes:
        """Return the packet of the next query; it moves nothing. Empty if there is no query.

        It is sent whenever a packet is due and no other is sent; to a board that was not recognised yet only
        with ability ASKED.
        """
        return b""

    def identity(self) -> str | None:
        """Return what distinguishes this board from others of its kind, and survives a loss of power.

        A board that returns after its port was lost is driven on only if it reports the same identity.

        Returns:
            None until the board has reported it; empty if it reports none.
        """
        return ""

    def begin_takeover(self) -> None:
        """Start a takeover: what the board reported so far does not count as a response."""
        return

    def limits(self) -> bytes:
        """Return the packet that sends the servos' ranges, or makes the board ready (ability LIMITS).

        It is sent when the board has (re)started and before its pose is taken over, repeatedly until
        `acknowledged`.
        """
        return b""

    def acknowledged(self) -> bool:
        """Return whether the board has acknowledged the packet of `limits` since `begin_takeover`."""
        return True

    def pose(self) -> Sequence[float] | None:
        """Return the joint angles in [rad] of the board's present pose; None if it has no pulses."""
        return None

    def measured(self) -> Sequence[float] | None:
        """Return the newest measured joint angles in [rad] (ability MEASURES); None before the first."""
        return None

    def deviation(self) -> str:
        """Return how the board deviates from its commands, as "holds by itself"; empty if it does not."""
        return ""

    def hold(self) -> bytes:
        """Return the packet that makes the board hold (ability HOLD); sent while the e-stop is latched."""
        return b""

    def relax(self) -> bytes:
        """Return the packet that switches pulses off (ability RELAX); sent when a port closes at rest."""
        return b""

    def values(self) -> Mapping[str, object]:
        """Return the newest values that the board reported, by name with unit, for /diagnostics."""
        return {}
