"""The extended protocol: pulse widths in frames with CRC, to boards that send telemetry.

Firmware of this protocol also takes legacy packets, holds and moves to rest by itself when no packets arrive,
and stores the servos' ranges.
"""

from __future__ import annotations

import math
import secrets
from collections import deque
from collections.abc import Mapping, Sequence

from servo_bridge.driver import PULSE_US_PER_180, angle_to_width, width_limits, width_to_angle, width_to_byte
from servo_bridge.protocols import frames
from servo_bridge.protocols.ascii_imu import LineParser, text_of
from servo_bridge.protocols.extended_board import FRAME_S, SLEW_US_PER_FRAME, ExtendedBoard
from servo_bridge.protocols.frames import SEQUENCES, Banner, BoardFlags, FrameParser, FrameType, Telemetry
from servo_bridge.protocols.legacy import PacketParser
from servo_bridge.protocols.protocol import Ability, BoardModel, BoardProtocol, Decoded, EncodedPacket
from softsim_core.scene import BoardDescription, Servo

# Widths this far in [us] outside of all commanded ones are another pose: one and a half degrees
TOLERANCE_US = 15.0
PATIENCE = 2  # number of contradicting telemetry frames in a row; a single one may have been sent in between
# Number of telemetry frames in a row without a new acknowledgement, though frames were sent: 0.3 s
DEAF_PATIENCE = 6


class PoseComparison:
    """Compares telemetry with the poses sent since the board's pose was last taken over.

    Attributes:
        deviation: How the board deviates, as the end of a message that begins with "the board"; empty if it
            does not.
    """

    def __init__(self) -> None:
        self.deviation = ""
        self._poses: deque[tuple[int, tuple[int, ...]]] = deque(maxlen=SEQUENCES - 1)
        self._sent = 0  # frames since the last telemetry
        self._acknowledged: int | None = None
        self._contradictions = self._deaf = 0

    def begin(self) -> None:
        """Begin a takeover: poses sent before do not count."""
        self.deviation = ""
        self._poses.clear()
        self._contradictions = self._deaf = 0

    def record_frame(self) -> None:
        """Record that a frame was sent."""
        self._sent += 1

    def record_pose(self, seq: int, widths_us: Sequence[int]) -> None:
        """Record that a pose was sent, in the frame with that number."""
        self._poses.append((seq, tuple(widths_us)))

    def compare(self, telemetry: Telemetry) -> None:
        """Compare a telemetry frame with the poses."""
        if telemetry.seq != self._acknowledged:
            self._deaf = 0
        elif self._sent and self._poses and telemetry.seq != self._poses[-1][0]:
            self._deaf += 1
        self._acknowledged, self._sent = telemetry.seq, 0
        contradiction = self._contradiction(telemetry)
        self._contradictions = self._contradictions + 1 if contradiction else 0
        if self._deaf >= DEAF_PATIENCE:
            self.deviation = "acknowledges no command; check the cable"
        elif self._contradictions >= PATIENCE:
            self.deviation = contradiction

    def _contradiction(self, telemetry: Telemetry) -> str:
        """Return how the telemetry contradicts the poses up to the acknowledged one; empty if it does not."""
        numbers = [seq for seq, _ in self._poses]
        if telemetry.seq not in numbers:
            return ""  # no pose sent since the takeover has arrived yet
        flags = telemetry.flags
        if BoardFlags.ACTIVE not in flags:
            return "has no pulses"
        if BoardFlags.LIMITS_SET not in flags:
            return "has forgotten its servos' ranges"
        if BoardFlags.HOMING in flags:
            return "moves to its rest pose by itself"
        if BoardFlags.HOLD in flags or BoardFlags.LINK not in flags:
            return "holds by itself"
        poses = [widths for _, widths in self._poses][: numbers.index(telemetry.seq) + 1]
        for width, sent_us in zip(telemetry.widths_us, zip(*poses, strict=True), strict=True):
            if not min(sent_us) - TOLERANCE_US <= width <= max(sent_us) + TOLERANCE_US:
                return f"is at {' '.join(map(str, telemetry.widths_us))} us, where it was not sent"
        return ""


RESET_CAUSES = {1: "power-on", 2: "external (port opened, or button)", 4: "brown-out", 8: "watchdog"}
MOST_QUESTIONS = 50  # a board that was asked for its number this often without an answer has none


def reset_cause_text(cause: int) -> str:
    """Return the bits of a banner's reset cause in words."""
    return ", ".join(text for bit, text in RESET_CAUSES.items() if cause & bit) or f"unknown ({cause})"


class ExtendedProtocol(BoardProtocol):
    """Frames to and from our firmware; lines of tilts between them are parsed.

    Attributes:
        banner: Newest banner; None before the first.
        telemetry: Newest telemetry since the board's start; None before the first.
        seq: Sequence number of the newest frame encoded; None before the first.
        unacknowledged, most_unacknowledged: Number of frames that the newest telemetry had not acknowledged,
            and its largest value.
        telemetry_frames, banners: Number of telemetry frames, and of banners (starts of the board).
    """

    name = "extended"
    abilities = (
        Ability.DETECT | Ability.TELEMETRY | Ability.HOLD | Ability.RELAX | Ability.LIMITS | Ability.REST
    )
    advice = "flash its firmware (softsim flash), or set the parameter protocol to auto"
    top_speed = math.radians(SLEW_US_PER_FRAME / PULSE_US_PER_180 * 180.0 / FRAME_S)

    def __init__(self, board: BoardDescription) -> None:
        super().__init__(board)
        self.banner: Banner | None = None
        self.telemetry: Telemetry | None = None
        self.seq: int | None = None
        self.unacknowledged = self.most_unacknowledged = self.telemetry_frames = self.banners = 0
        self._frames, self._lines = FrameParser(), LineParser()
        self._following = PoseComparison()
        self._limits_seq: int | None = None  # of the ranges sent since the takeover began
        self._number: int | None = None  # of the board; None: not known
        self._offered = frames.NO_IDENTITY  # number given to a board that has none
        self._questions = 0  # for its number, since the newest answer
        self._answered = False  # since the takeover began

    @classmethod
    def refusal(cls, board: BoardDescription) -> str:
        """Refuse a board whose number of servos is not that of a frame."""
        if len(board.servos) == frames.SERVOS:
            return ""
        return (
            f"the board has {len(board.servos)} servos, the extended protocol {frames.SERVOS};"
            " set the parameter protocol to auto"
        )

    @classmethod
    def board_model(cls, servos: Sequence[Servo]) -> BoardModel | None:
        """Return the firmware's model, for three servos."""
        return ExtendedBoard(PacketParser(frames.SERVOS)) if len(servos) == frames.SERVOS else None

    def encode_pose(self, angles_rad: Sequence[float]) -> EncodedPacket:
        """Encode a SET frame of pulse widths."""
        widths = [angle_to_width(angle, servo) for angle, servo in zip(angles_rad, self.servos, strict=True)]
        seq = self._next_seq()
        self._following.record_pose(seq, widths)
        return EncodedPacket(
            frames.set_widths(seq, widths),
            tuple(round(width_to_byte(width)) for width in widths),
            tuple(width_to_angle(width, servo) for width, servo in zip(widths, self.servos, strict=True)),
        )

    def decode(self, data: bytes) -> Decoded:
        """Process banners, telemetry and lines of tilts; frames that echo sent ones are ignored."""
        recognised = restarted = False
        for frame in self._frames.feed(data):
            if frame.kind is FrameType.BANNER:
                self.banner = frames.read_banner(frame)
                self.telemetry = None  # the telemetry was from before the reset
                self.banners += 1
                recognised = restarted = True
            elif frame.kind is FrameType.TELEMETRY:
                self.telemetry = telemetry = frames.read_telemetry(frame)
                self.telemetry_frames += 1
                self._following.compare(telemetry)
                if self.seq is not None:
                    self.unacknowledged = (self.seq - telemetry.seq) % SEQUENCES
                    self.most_unacknowledged = max(self.most_unacknowledged, self.unacknowledged)
                recognised = True
            elif frame.kind is FrameType.IDENTITY:
                number = frames.read_number(frame)
                if number != frames.NO_IDENTITY:
                    self._number, self._answered, self._questions = number, True, 0
                elif self._offered == frames.NO_IDENTITY:  # the next query offers the board a number
                    self._offered = secrets.randbelow(frames.NO_IDENTITY)
        return Decoded(recognised, restarted, tuple(self._lines.feed(text_of(data))))

    @property
    def ready(self) -> bool:
        """Whether telemetry was received since the board's start."""
        return self.telemetry is not None

    def fault(self) -> str:
        """Refuse a board that speaks another version of the protocol."""
        if self.banner is None or self.banner.protocol == frames.PROTOCOL_VERSION:
            return ""
        return (
            f"speaks version {self.banner.protocol} of the extended protocol, this bridge version"
            f" {frames.PROTOCOL_VERSION}; flash its firmware again (softsim flash), or set the parameter"
            " protocol to legacy"
        )

    def pose(self) -> tuple[float, ...] | None:
        """Return the angles of the widths in telemetry: of the pulses, or of those before a reset."""
        if self.telemetry is None or not all(self.telemetry.widths_us):
            return None
        widths = self.telemetry.widths_us
        return tuple(width_to_angle(width, servo) for width, servo in zip(widths, self.servos, strict=True))

    def identity(self) -> str | None:
        """Return the number in the board's EEPROM; a board without one is assigned one."""
        if self._number is not None:
            return f"number {self._number:012x}"
        return None if self._may_answer else ""

    def ask(self) -> bytes:
        """Return IDENTIFY until the board has reported its number, or was asked often enough."""
        if not self._may_answer or self._number is not None:
            return b""
        self._questions += 1
        return frames.identify(self._next_seq(), self._offered)

    def begin_takeover(self) -> None:
        """Start a takeover: earlier acknowledgements and an earlier number are no answer."""
        self._limits_seq = None
        self._answered, self._questions = False, 0
        self._following.begin()

    def limits(self) -> bytes:
        """Return IDENTIFY, then SET_LIMITS with range and rest of every servo.

        Repetitions of SET_LIMITS have the same sequence number.
        """
        question = b""
        if not self._answered and self._may_answer:
            self._questions += 1
            question = frames.identify(self._next_seq(), self._offered)
        if self._limits_seq is None:
            self._limits_seq = self._next_seq()
            # With the number that telemetry shows now, the frame would count as acknowledged at once.
            if self.telemetry is not None and self._limits_seq == self.telemetry.seq:
                self._limits_seq = self._next_seq()
        return question + frames.set_limits(self._limits_seq, [width_limits(servo) for servo in self.servos])

    def acknowledged(self) -> bool:
        """Return whether telemetry acknowledges the ranges, and the board has reported its number."""
        return (
            (self._answered or not self._may_answer)
            and self.telemetry is not None
            and self.telemetry.seq == self._limits_seq
            and BoardFlags.LIMITS_SET in self.telemetry.flags
        )

    def deviation(self) -> str:
        """Return how telemetry contradicts the poses that were sent."""
        return self._following.deviation

    def hold(self) -> bytes:
        """Return a HOLD frame."""
        self._following.begin()
        return frames.hold(self._next_seq())

    def relax(self) -> bytes:
        """Return a RELAX frame."""
        return frames.relax(self._next_seq())

    @property
    def frames_dropped(self) -> int:
        """Number of damaged frames from the board."""
        return self._frames.dropped

    def values(self) -> Mapping[str, object]:
        """Return firmware, reset cause, and the newest telemetry."""
        values: dict[str, object] = {}
        if self.banner is not None:
            values |= {
                "firmware": f"{self.banner.major}.{self.banner.minor}",
                "reset cause": reset_cause_text(self.banner.reset_cause),
            }
        values["board number"] = "none" if self._number is None else f"{self._number:012x}"
        telemetry = self.telemetry
        if telemetry is not None:
            flags = (str(flag.name).lower() for flag in BoardFlags if flag in telemetry.flags)
            values |= {
                "board flags": " ".join(flags) or "none",
                "pulse widths [us]": " ".join(map(str, telemetry.widths_us)),
                "acknowledged": telemetry.seq,
                "frames unacknowledged": self.unacknowledged,
                "most unacknowledged": self.most_unacknowledged,
                "board rejects": telemetry.rejects,
                "board overruns": telemetry.overruns,
                "telemetry damaged": self.frames_dropped,
            }
        return {**values, **self._lines.values()}

    @property
    def _may_answer(self) -> bool:
        """Whether the firmware knows IDENTIFY, according to its banner and its answers."""
        banner = self.banner
        old = banner is not None and (banner.major, banner.minor) < frames.IDENTIFYING_FIRMWARE
        return not old and self._questions < MOST_QUESTIONS

    def _next_seq(self) -> int:
        self._following.record_frame()
        self.seq = 1 if self.seq is None else (self.seq + 1) % SEQUENCES
        return self.seq
