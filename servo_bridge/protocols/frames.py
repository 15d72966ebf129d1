"""Frames of the extended protocol: pulse widths out, telemetry in, with sequence number and CRC. No I/O.

    0xFE, type, seq, payload, CRC-8 (high two bits), CRC-8 (low six bits)

Every byte after the first carries six bits, as 0x80 | value: a frame never contains the legacy header 255, a
legacy servo byte, or a command of the Uno's boot loader. Numbers of 12 bits take two sextets, high one first.
The type fixes the length. The CRC-8 (polynomial 0x07, initial value 0) runs over the sextet values of type,
seq and payload.

Functions that encode raise PacketError for a wrong number of values, or one that does not fit; those that
read raise it for a frame of another type.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import IntEnum, IntFlag

from servo_bridge import PacketError

FRAME_HEADER = 0xFE  # first byte of a frame; no other byte of a frame has this value
PROTOCOL_VERSION = 2  # protocol version in the banner of a board of this protocol
FIRMWARE_VERSION = (2, 2)  # major and minor version of firmware/tripod.c, which the banner carries, too
IDENTIFYING_FIRMWARE = (2, 2)  # first firmware version that answers IDENTIFY
SERVOS = 3  # number of servos in a frame
IDENTITY_SEXTETS = 8
# Number of a board that has none; every smaller one, from 0 on, is a valid number
NO_IDENTITY = 64**IDENTITY_SEXTETS - 1
SEQUENCES = 64  # sequence numbers run from 0 to 63 and start again
_LARGEST_12_BIT = 4095


class FrameType(IntEnum):
    """Types of frames: below 16 from the computer to the board, from 16 on from the board."""

    SET = 1
    RELAX = 2
    HOLD = 3
    PING = 4
    SET_LIMITS = 5
    SLEW = 6
    IDENTIFY = 7
    BANNER = 16
    TELEMETRY = 17
    IDENTITY = 18


# Length of each type's payload in sextets
PAYLOAD_SEXTETS: dict[int, int] = {
    FrameType.SET: 2 * SERVOS,
    FrameType.RELAX: 0,
    FrameType.HOLD: 0,
    FrameType.PING: 0,
    FrameType.SET_LIMITS: 6 * SERVOS,
    FrameType.SLEW: 2,
    FrameType.IDENTIFY: IDENTITY_SEXTETS,
    FrameType.BANNER: 4,
    FrameType.TELEMETRY: 7 + 2 * SERVOS,
    FrameType.IDENTITY: IDENTITY_SEXTETS,
}


class BoardFlags(IntFlag):
    """State of the board in its telemetry.

    LINK: a valid command came within 0.5 s. HOLD: the servos hold. HOMING: they move slowly to the rest pose.
    ACTIVE: pulses are on. RELAXED: they were switched off by RELAX. LIMITS_SET: SET_LIMITS was accepted.
    WATCHDOG: a watchdog reset was detected.
    """

    LINK = 1
    HOLD = 2
    HOMING = 4
    ACTIVE = 8
    RELAXED = 16
    LIMITS_SET = 32
    WATCHDOG = 64


@dataclass(frozen=True, slots=True)
class Frame:
    """One whole frame: type, sequence number and the payload's sextet values (0..63 each)."""

    kind: FrameType
    seq: int
    payload: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Banner:
    """Message of the board after a reset."""

    protocol: int  # version
    major: int  # of the firmware's version
    minor: int
    reset_cause: int  # bits of the processor: 1 power-on, 2 external, 4 brown-out, 8 watchdog


@dataclass(frozen=True, slots=True)
class Telemetry:
    """State of the board, 10 to 50 times per second."""

    seq: int  # sequence number of the newest accepted frame: the acknowledgement
    flags: BoardFlags  # see `BoardFlags`
    widths_us: tuple[int, ...]  # pulse widths after the board's slew limit in [us], one per servo
    rejects: int  # frames and packets refused since the reset, 12 bits
    overruns: int  # received bytes lost since the reset, 12 bits


def crc8(values: Iterable[int]) -> int:
    """Return the CRC-8 of byte values: polynomial 0x07, initial value 0, not reflected, not inverted."""
    crc = 0
    for value in values:
        crc ^= value
        for _ in range(8):
            crc = ((crc << 1) ^ 0x07 if crc & 0x80 else crc << 1) & 0xFF
    return crc


def split12(values: Sequence[int]) -> tuple[int, ...]:
    """Return two sextets, high one first, for each 12-bit number."""
    for value in values:
        if not 0 <= value <= _LARGEST_12_BIT:
            raise PacketError(f"{value} does not fit into 12 bits; allowed are 0..{_LARGEST_12_BIT}")
    return tuple(sextet for value in values for sextet in (value >> 6, value & 0x3F))


def join12(sextets: Sequence[int]) -> tuple[int, ...]:
    """Return the 12-bit numbers of pairs of sextets; the inverse of `split12`."""
    return tuple((high << 6) | low for high, low in zip(sextets[::2], sextets[1::2], strict=True))


def encode(frame: Frame) -> bytes:
    """Return the bytes of a frame."""
    length = PAYLOAD_SEXTETS[frame.kind]
    if len(frame.payload) != length:
        raise PacketError(f"{frame.kind.name} takes {length} sextets, not {len(frame.payload)}")
    body = (int(frame.kind), frame.seq, *frame.payload)
    for value in body:
        if not 0 <= value < 64:
            raise PacketError(f"{frame.kind.name}: {value} does not fit into a sextet; allowed are 0..63")
    crc = crc8(body)
    return bytes([FRAME_HEADER, *(0x80 | value for value in (*body, crc >> 6, crc & 0x3F))])


def set_widths(seq: int, widths_us: Sequence[int]) -> bytes:
    """Encode SET: pulse widths in [us], one per servo."""
    return encode(Frame(FrameType.SET, seq, split12(widths_us)))


def relax(seq: int) -> bytes:
    """Encode RELAX: pulses off."""
    return encode(Frame(FrameType.RELAX, seq))


def hold(seq: int) -> bytes:
    """Encode HOLD: stay at the present widths."""
    return encode(Frame(FrameType.HOLD, seq))


def ping(seq: int) -> bytes:
    """Encode PING: request only an acknowledgement."""
    return encode(Frame(FrameType.PING, seq))


def set_limits(seq: int, limits_us: Sequence[tuple[int, int, int]]) -> bytes:
    """Encode SET_LIMITS: smallest, rest and largest pulse width in [us], three per servo."""
    return encode(Frame(FrameType.SET_LIMITS, seq, split12([each for three in limits_us for each in three])))


def slew(seq: int, us_per_frame: int) -> bytes:
    """Encode SLEW: largest change of a pulse width in [us] per pulse period of 20 ms."""
    return encode(Frame(FrameType.SLEW, seq, split12([us_per_frame])))


def identify(seq: int, number: int = NO_IDENTITY) -> bytes:
    """Encode IDENTIFY: ask a board for its number, and assign one if it has none; nothing moves."""
    return encode(Frame(FrameType.IDENTIFY, seq, _number_sextets(number)))


def identity(seq: int, number: int) -> bytes:
    """Encode IDENTITY, as the board sends it."""
    return encode(Frame(FrameType.IDENTITY, seq, _number_sextets(number)))


def read_number(frame: Frame) -> int:
    """Return the number in an IDENTIFY or IDENTITY frame."""
    if frame.kind is not FrameType.IDENTIFY:
        _check_kind(frame, FrameType.IDENTITY)
    number = 0
    for sextet in frame.payload:
        number = number << 6 | sextet
    return number


def _number_sextets(number: int) -> tuple[int, ...]:
    if not 0 <= number <= NO_IDENTITY:
        raise PacketError(f"board number {number} refused; allowed are 0..{NO_IDENTITY}")
    return tuple(number >> 6 * place & 0x3F for place in reversed(range(IDENTITY_SEXTETS)))


def banner(seq: int, content: Banner) -> bytes:
    """Encode BANNER, as the board sends it."""
    payload = (content.protocol, content.major, content.minor, content.reset_cause)
    return encode(Frame(FrameType.BANNER, seq, payload))


def telemetry(seq: int, content: Telemetry) -> bytes:
    """Encode TELEMETRY, as the board sends it."""
    numbers = split12([int(content.flags), *content.widths_us, content.rejects, content.overruns])
    return encode(Frame(FrameType.TELEMETRY, seq, (content.seq, *numbers)))


def read_banner(frame: Frame) -> Banner:
    """Return the content of a BANNER frame."""
    _check_kind(frame, FrameType.BANNER)
    return Banner(*frame.payload)


def read_telemetry(frame: Frame) -> Telemetry:
    """Return the content of a TELEMETRY frame."""
    _check_kind(frame, FrameType.TELEMETRY)
    flags, *widths, rejects, overruns = join12(frame.payload[1:])
    return Telemetry(frame.payload[0], BoardFlags(flags), tuple(widths), rejects, overruns)


def _check_kind(frame: Frame, kind: FrameType) -> None:
    if frame.kind is not kind:
        raise PacketError(f"frame of type {frame.kind.name} where {kind.name} was expected")


@dataclass(slots=True)
class FrameParser:
    """Parser that finds frames in a stream of bytes, whatever is between them.

    The header always starts a new frame. A byte without the form of a sextet, an unknown type or a wrong CRC
    drops the frame. Bytes outside frames (legacy packets, start-up text) are ignored.
    """

    accepted: int = 0  # number of frames accepted so far
    dropped: int = 0  # number of frames dropped so far
    _body: list[int] | None = field(default=None, repr=False)

    @property
    def begun(self) -> bool:
        """Whether a frame has begun and not ended."""
        return self._body is not None

    def reset(self) -> None:
        """Discard an unfinished frame; the counters stay."""
        self._body = None

    def drop(self) -> None:
        """Discard an unfinished frame and count it; without one nothing happens."""
        if self._body is not None:
            self._body = None
            self.dropped += 1

    def feed(self, data: bytes) -> list[Frame]:
        """Return the frames completed by these bytes, oldest first; never raises."""
        return [frame for frame in map(self._take, data) if frame is not None]

    def _take(self, value: int) -> Frame | None:
        if value == FRAME_HEADER:
            self.drop()
            self._body = []
            return None
        body = self._body
        if body is None:
            return None
        if not 0x80 <= value <= 0xBF:
            self.drop()
            return None
        body.append(value & 0x3F)
        length = PAYLOAD_SEXTETS.get(body[0])
        if length is None:
            self.drop()
        elif len(body) == 4 + length:
            content, (high, low) = body[:-2], body[-2:]
            if (high << 6) | low == crc8(content):  # also refuses the four unused bits
                self._body = None
                self.accepted += 1
                return Frame(FrameType(content[0]), content[1], tuple(content[2:]))
            self.drop()
        return None
