"""A bus of Dynamixel servos without hardware: packets in, status packets out. Pure, no clock.

What comes back from it can be lost, late or damaged, drawn from a seed. Not modelled: the time of bytes on
the line.
"""

from __future__ import annotations

import random
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from servo_bridge.protocols import dynamixel_table as table
from servo_bridge.protocols.dynamixel_packets import (
    ALERT,
    BROADCAST,
    Instruction,
    Packet,
    PacketStream,
    StatusError,
    status,
)
from servo_bridge.protocols.dynamixel_servo import HARDWARE_ERROR, EmulatedServo
from servo_bridge.protocols.protocol import BoardModel

LONGEST_LAG_S = 10.0


@dataclass(slots=True)
class LineFaults:
    """What happens to status packets on their way, each drawn for itself.

    Attributes:
        lost: Share of those that never arrive.
        late: Share of those that arrive with the next answers only.
        damaged: Share of those in which a bit is flipped, or that are cut short.
        unheard: Share of packets to the servos that no servo hears.
        draw: Source of the draws.
    """

    lost: float = 0.0
    late: float = 0.0
    damaged: float = 0.0
    unheard: float = 0.0
    draw: random.Random = field(default_factory=lambda: random.Random(1))

    def happens(self, share: float) -> bool:
        """One draw."""
        return share > 0.0 and self.draw.random() < share


class DynamixelBus(BoardModel):
    """Servos on one line, and the adapter through which a computer reaches them.

    Args:
        servo_ids: Their numbers.

    Attributes:
        servos: By number.
        faults: What happens on the way; none at first.
    """

    say_period_s = 0.02
    largest = 4095

    def __init__(self, servo_ids: Sequence[int]) -> None:
        self.servos = {servo_id: EmulatedServo(servo_id) for servo_id in servo_ids}
        self.faults = LineFaults()
        self._stream = PacketStream()
        self._answers: list[bytes] = []
        self._late: list[bytes] = []
        self._accepted = self._damaged = 0
        self._now: float | None = None

    @property
    def accepted(self) -> int:
        """Sync writes of goals to all servos that all have taken."""
        return self._accepted

    @property
    def dropped(self) -> int:
        """Packets that came damaged, and writes refused."""
        return self._damaged + self._stream.damaged + sum(servo.refused for servo in self.servos.values())

    def reset(self, cause: int) -> None:
        """The port was opened: the adapter forgets what it was in; servos with power do not notice."""
        self._damaged += self._stream.damaged
        self._stream, self._answers, self._late = PacketStream(), [], []

    def feed(self, data: bytes, now: float) -> list[tuple[int, ...]]:
        """Take bytes; the goals that all servos have taken, in pulses, oldest first."""
        self.advance(now)
        poses = []
        for packet in self._stream.feed(data):
            if packet.instruction == Instruction.STATUS or self.faults.happens(self.faults.unheard):
                continue
            for servo in self.servos.values():
                servo.heard(now)
            if self._carry_out(packet):
                poses.append(tuple(servo.goal for servo in self.servos.values()))
        self._accepted += len(poses)
        return poses

    def answer(self, now: float) -> bytes:
        """Status packets, after what happens to them on their way."""
        answers, self._late = self._late, []
        for each in self._answers:
            if self.faults.happens(self.faults.lost):
                continue
            if self.faults.happens(self.faults.damaged):
                each = self._damage(each)
            (self._late if self.faults.happens(self.faults.late) else answers).append(each)
        self._answers = []
        return b"".join(answers)

    def say(self, now: float) -> bytes:
        """Nothing: servos speak only when they are asked. Time passes."""
        self.advance(now)
        return b""

    def advance(self, now: float) -> None:
        """Let the servos move."""
        passed_s = 0.0 if self._now is None else min(max(now - self._now, 0.0), LONGEST_LAG_S)
        self._now = now
        for servo in self.servos.values():
            servo.advance(now, passed_s)

    @property
    def positions(self) -> dict[int, float]:
        """Where the servos stand, in pulses, by number."""
        return {servo_id: servo.position for servo_id, servo in self.servos.items()}

    def _carry_out(self, packet: Packet) -> bool:
        """Do what a packet asks; whether all servos have taken goals of it."""
        body = packet.parameters
        if packet.instruction == Instruction.SYNC_WRITE and len(body) >= 4:
            return self._sync_write(body)
        if packet.instruction in (Instruction.SYNC_READ, Instruction.BULK_READ):
            self._read_all(packet.instruction, body)
        elif packet.servo_id == BROADCAST:
            if packet.instruction == Instruction.PING:
                for servo_id, servo in sorted(self.servos.items()):
                    if servo.answers:
                        self._ask(servo_id, packet)
        elif packet.servo_id in self.servos and self.servos[packet.servo_id].answers:
            self._ask(packet.servo_id, packet)
        return False

    def _sync_write(self, body: bytes) -> bool:
        address, size = struct.unpack_from("<HH", body)
        taken = set()
        for at in range(4, len(body) - size, size + 1):
            servo = self.servos.get(body[at])
            if (
                servo is not None
                and servo.answers
                and servo.write(address, body[at + 1 : at + 1 + size]) is None
            ):
                taken.add(body[at])
        return address == table.GOAL_POSITION and taken == set(self.servos)

    def _read_all(self, instruction: int, body: bytes) -> None:
        """Each servo answers after the one before it: behind one that is not there, none does."""
        for servo_id, address, size in _places(instruction, body):
            servo = self.servos.get(servo_id)
            if servo is None or not servo.answers:
                return
            self._tell(servo_id, servo.read(address, size))

    def _ask(self, servo_id: int, packet: Packet) -> None:
        servo, body = self.servos[servo_id], packet.parameters
        if packet.instruction == Instruction.PING:
            self._tell(servo_id, servo.get(0).to_bytes(2, "little") + bytes([servo.get(6)]))
        elif packet.instruction == Instruction.READ and len(body) == 4:
            self._tell(servo_id, servo.read(*struct.unpack("<HH", body)))
        elif packet.instruction == Instruction.WRITE and len(body) > 2:
            self._tell(servo_id, servo.write(int.from_bytes(body[:2], "little"), body[2:]) or b"")
        elif packet.instruction == Instruction.REBOOT:
            servo.power_cycle()
            self._tell(servo_id, b"")
        else:
            self._tell(servo_id, StatusError.INSTRUCTION)

    def _tell(self, servo_id: int, said: bytes | StatusError) -> None:
        alert = ALERT if self.servos[servo_id].get(HARDWARE_ERROR) else 0
        if isinstance(said, StatusError):
            self._answers.append(status(servo_id, b"", said | alert))
        else:
            self._answers.append(status(servo_id, said, alert))

    def _damage(self, answer: bytes) -> bytes:
        draw, spoilt = self.faults.draw, bytearray(answer)
        at = draw.randrange(len(spoilt))
        if draw.random() < 0.3:
            return bytes(spoilt[:at])
        spoilt[at] ^= 1 << draw.randrange(8)
        return bytes(spoilt)


def _places(instruction: int, body: bytes) -> Iterator[tuple[int, int, int]]:
    """Number, address and size of each servo that is to be read."""
    if instruction == Instruction.BULK_READ:
        for at in range(0, len(body) - 4, 5):
            yield struct.unpack_from("<BHH", body, at)
    elif len(body) >= 4:
        address, size = struct.unpack_from("<HH", body)
        for servo_id in body[4:]:
            yield servo_id, address, size
