"""One pose as the bytes to write, in each of three protocols, and what the servos are really told. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from servo_bridge import codec, frames
from servo_bridge.ascii_codec import encode_line
from softsim_core.scene.description import ServoCalibration


@dataclass(frozen=True, slots=True)
class Outgoing:
    """A packet and its meaning.

    Attributes:
        data: Bytes for one write.
        servo_bytes: Degrees of the servos, in packet order; rounded where the packet is finer.
        angles_rad: Nominal joint angles of what the packet says, in [rad].
        avoided: Whether a byte 100 was replaced.
    """

    data: bytes
    servo_bytes: tuple[int, ...]
    angles_rad: tuple[float, ...]
    avoided: bool = False


def legacy(
    angles_rad: Sequence[float], servos: Sequence[ServoCalibration], header: int, avoid_byte_100: bool
) -> Outgoing:
    """The pose as a legacy packet; see `codec.avoid_byte_100`.

    Raises:
        CommandError: wrong number of angles, or one that is not finite.
    """
    packet = codec.encode_packet(angles_rad, servos, header)
    sent = codec.avoid_byte_100(packet, servos) if avoid_byte_100 else packet
    servo_bytes = tuple(sent[1:])
    return Outgoing(sent, servo_bytes, codec.bytes_to_angles(servo_bytes, servos), sent != packet)


def extended(angles_rad: Sequence[float], servos: Sequence[ServoCalibration], seq: int) -> Outgoing:
    """The pose as a SET frame.

    Raises:
        CommandError: an angle is not finite.
    """
    widths = [codec.angle_to_width(angle, servo) for angle, servo in zip(angles_rad, servos, strict=True)]
    return Outgoing(
        frames.set_widths(seq, widths),
        tuple(round(frames.width_to_byte(width)) for width in widths),
        tuple(codec.width_to_angle(width, servo) for width, servo in zip(widths, servos, strict=True)),
    )


def ascii_line(angles_rad: Sequence[float], servos: Sequence[ServoCalibration]) -> Outgoing:
    """The pose as a line of text.

    Raises:
        CommandError: wrong number of angles, or one that is not finite.
        PacketError: a servo's range goes beyond 60..180.
    """
    servo_bytes = tuple(codec.encode_packet(angles_rad, servos)[1:])
    return Outgoing(encode_line(servo_bytes), servo_bytes, codec.bytes_to_angles(servo_bytes, servos))
