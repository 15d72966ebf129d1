"""A bus of Dynamixel servos without hardware: control tables, motion, status packets. No clock.

It refuses what a real servo refuses, moves by its profile, is stopped by its bus watchdog, and can be
overloaded, turned by hand, or taken off the bus. Load, gravity and current are not modelled.

Responses can be lost, late or damaged, drawn from a seed. The time of bytes on the line is not modelled.
"""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import NamedTuple

from servo_bridge.driver import PULSES_PER_RAD
from servo_bridge.protocols import dynamixel_packets as table
from servo_bridge.protocols.dynamixel_packets import (
    ALERT,
    BROADCAST,
    HardwareError,
    Instruction,
    Packet,
    PacketStream,
    StatusError,
    status,
)
from servo_bridge.protocols.protocol import BoardModel
from softsim_core.physics.mechanics import JointLimits

MODEL, FIRMWARE = 1030, 45
TABLE_SIZE, RAM_START = 147, 64
# Acceleration of the motor without a profile, in [pulses/s^2]; an estimate without a measurement
LARGEST_ACCELERATION = 200.0 * PULSES_PER_RAD
LONGEST_STEP_S = 0.005
HARDWARE_ERROR, WATCHDOG, PROFILE_VELOCITY = 70, table.BUS_WATCHDOG, table.PROFILE + 4


class Item(NamedTuple):
    """One number of the control table: bytes, value after power-on, range to write (None: read-only)."""

    size: int
    initial: int
    range: tuple[int, int] | None = None


# The table up to the temperature; other addresses are read-only, and read as 0
ITEMS: Mapping[int, Item] = MappingProxyType({
    0: Item(2, MODEL), 6: Item(1, FIRMWARE), 7: Item(1, 1, (0, 252)),  # id
    8: Item(1, 3, (0, 7)), 9: Item(1, 250, (0, 254)),  # baud rate, return delay
    10: Item(1, 0, (0, 5)), 11: Item(1, table.POSITION_MODE, (0, 16)),  # drive mode, operating mode
    12: Item(1, 255, (0, 255)), 13: Item(1, 2, (1, 2)),  # second id, protocol
    20: Item(4, 0, (-1_044_479, 1_044_479)), 24: Item(4, 10, (0, 1023)),  # homing offset, moving threshold
    31: Item(1, 80, (0, 100)),  # highest temperature
    32: Item(2, 160, (95, 160)), 34: Item(2, 95, (95, 160)),  # highest and lowest voltage
    36: Item(2, 885, (0, 885)), 38: Item(2, 1193, (0, 1193)),  # largest PWM and current
    44: Item(4, 330, (0, 1023)), 48: Item(4, 4095, (0, 4095)), 52: Item(4, 0, (0, 4095)),  # speed, range
    63: Item(1, 0x34, (0, 63)),  # shutdown
    64: Item(1, 0, (0, 1)), 65: Item(1, 0, (0, 1)), 68: Item(1, 2, (0, 2)),  # torque, LED, return level
    HARDWARE_ERROR: Item(1, 0), WATCHDOG: Item(1, 0, (0, 127)),
    76: Item(2, 1920, (0, 16383)), 78: Item(2, 100, (0, 16383)),  # gains of the velocity
    80: Item(2, 0, (0, 16383)), 82: Item(2, 0, (0, 16383)), 84: Item(2, 800, (0, 16383)),  # of the position
    88: Item(2, 0, (0, 16383)), 90: Item(2, 0, (0, 16383)),  # feedforward
    100: Item(2, 885, (-885, 885)), 102: Item(2, 1193, (-1193, 1193)), 104: Item(4, 0, (-1023, 1023)),  # goal
    table.PROFILE: Item(4, 0, (0, 32767)), PROFILE_VELOCITY: Item(4, 0, (0, 32767)),
    table.GOAL_POSITION: Item(4, 0, (0, 4095)), 128: Item(4, 0), 132: Item(4, 0),  # present speed, position
    144: Item(2, 120), 146: Item(1, 30),  # voltage, temperature
})  # fmt: skip


class EmulatedServo:
    """One XM430-W210; times are seconds of any steady clock.

    Attributes:
        answers: Whether it is on the bus and has power.
        fed: Time in [s] of the newest instruction packet on the bus.
        position: Position in pulses.
        velocity: Velocity in [pulses/s].
        goals: Smallest and largest goal that was ever sent to it, accepted or not; None before the first.
        refused: Number of writes refused.
    """

    def __init__(self, servo_id: int) -> None:
        self.answers = True
        self.position, self.velocity = 2048.0, 0.0
        self.goals: tuple[int, int] | None = None
        self.refused = 0
        self._table = bytearray(TABLE_SIZE)
        for address in ITEMS:
            self.put(address, ITEMS[address].initial)
        self.put(7, servo_id)
        self.fed = 0.0
        self.power_cycle()

    def power_cycle(self) -> None:
        """Switch it off and on: settings stay, the rest is initialised; it has no torque."""
        for address, item in ITEMS.items():
            if address >= RAM_START:
                self.put(address, item.initial)
        self.velocity = 0.0
        self.put(table.GOAL_POSITION, round(self.position))

    def get(self, address: int) -> int:
        """Return a number of the control table."""
        raw = self._table[address : address + ITEMS[address].size]
        return int.from_bytes(raw, "little", signed=len(raw) > 1)

    def put(self, address: int, value: int) -> None:
        """Set a number of the control table, allowed or not."""
        size = ITEMS[address].size
        self._table[address : address + size] = value.to_bytes(size, "little", signed=size > 1 and value < 0)

    @property
    def torque(self) -> bool:
        """Whether it has torque."""
        return bool(self.get(table.TORQUE_ENABLE))

    @property
    def goal(self) -> int:
        """Goal position in pulses."""
        return self.get(table.GOAL_POSITION)

    def fail(self, error: HardwareError) -> None:
        """Cause a hardware error.

        An error that its setting names switches the torque off until the power was off.
        """
        self.put(HARDWARE_ERROR, self.get(HARDWARE_ERROR) | error)
        if error & self.get(63):
            self.put(table.TORQUE_ENABLE, 0)

    def turn(self, pulse: float) -> None:
        """Turn it by hand to a position in pulses."""
        self.position = pulse

    def read(self, address: int, size: int) -> bytes | StatusError:
        """Return bytes of the control table, or the error of the request."""
        if size < 1 or address + size > TABLE_SIZE:
            return StatusError.ACCESS
        self.put(128, round(self.velocity / PULSES_PER_RAD / table.VELOCITY_UNIT))
        self.put(132, round(self.position))
        return bytes(self._table[address : address + size])

    def write(self, address: int, data: bytes) -> StatusError | None:
        """Write whole numbers from an address on, all or none; return the error, or None."""
        error = self._objection(address, data)
        if error is not None:
            self.refused += 1
            return error
        had_torque = self.torque
        self._table[address : address + len(data)] = data
        if self.torque and not had_torque:
            self.velocity = 0.0
        return None

    def advance(self, now: float, passed_s: float) -> None:
        """Advance by `passed_s` to the time `now`."""
        start = now - passed_s
        limit_s = self.get(WATCHDOG) * table.WATCHDOG_UNIT_S
        trips = self.torque and 0 < self.get(WATCHDOG) <= 127 and now - self.fed > limit_s
        if trips:
            self._move(max(self.fed + limit_s - start, 0.0))
            self.put(WATCHDOG, table.WATCHDOG_TRIPPED)
            self.put(table.GOAL_POSITION, round(self.position))
            self.put(table.PROFILE, 0)
            self.put(PROFILE_VELOCITY, 0)
            self.velocity = 0.0
        else:
            self._move(passed_s)

    def _move(self, passed_s: float) -> None:
        if not self.torque or passed_s <= 0.0:
            return
        speed = min(self.get(PROFILE_VELOCITY) or math.inf, self.get(44)) * table.VELOCITY_UNIT
        steepness = self.get(table.PROFILE) * 214.577 * 2.0 * math.pi / 3600.0 * PULSES_PER_RAD
        limits = JointLimits(
            speed=speed * PULSES_PER_RAD, acceleration=min(steepness or math.inf, LARGEST_ACCELERATION)
        )
        steps = max(1, math.ceil(passed_s / LONGEST_STEP_S))
        for _ in range(steps):
            if self.position == self.goal and self.velocity == 0.0:
                return
            self.position, self.velocity = limits.step(
                self.position, self.velocity, float(self.goal), passed_s / steps
            )

    def _objection(self, address: int, data: bytes) -> StatusError | None:
        """Return the error of a write, as a real servo reports it; None if it is allowed."""
        end = address + len(data)
        if address <= table.GOAL_POSITION < end <= TABLE_SIZE and end >= table.GOAL_POSITION + 4:
            goal = struct.unpack_from("<i", data, table.GOAL_POSITION - address)[0]
            low, high = self.goals or (goal, goal)
            self.goals = min(low, goal), max(high, goal)
        while address < end:
            item = ITEMS.get(address)
            if item is None or item.range is None or (address < RAM_START and self.torque):
                return StatusError.ACCESS
            if end - address < item.size:
                return StatusError.DATA_LENGTH
            value = int.from_bytes(data[: item.size], "little", signed=item.size > 1)
            if not item.range[0] <= value <= item.range[1]:
                return StatusError.DATA_RANGE
            if address in (100, 102, 104, 116) and self.get(WATCHDOG) == table.WATCHDOG_TRIPPED:
                return StatusError.DATA_RANGE
            if address == table.GOAL_POSITION and not self.get(52) <= value <= self.get(48):
                return StatusError.DATA_LIMIT
            if address == table.TORQUE_ENABLE and value and self.get(HARDWARE_ERROR) & self.get(63):
                return StatusError.RESULT_FAIL
            address, data = address + item.size, data[item.size :]
        return None


LONGEST_LAG_S = 10.0


@dataclass(slots=True)
class LineFaults:
    """Faults of status packets on the line, each drawn independently."""

    lost: float = 0.0  # fraction of packets that never arrive
    late: float = 0.0  # fraction of packets that arrive with the next responses only
    damaged: float = 0.0  # fraction of packets in which a bit is flipped, or that are cut short
    unheard: float = 0.0  # fraction of packets to the servos that no servo receives
    draw: random.Random = field(default_factory=lambda: random.Random(1))  # random number generator

    def happens(self, fraction: float) -> bool:
        """Draw whether a fault with this fraction happens."""
        return fraction > 0.0 and self.draw.random() < fraction


class DynamixelBus(BoardModel):
    """Servos on one line, and the adapter through which a computer reaches them.

    Attributes:
        servos: Servos by id.
        faults: Faults of the line; none at first.
        accepted: Number of sync writes with goals for all servos that all have accepted.
    """

    accepted = 0
    say_period_s = 0.02
    largest = 4095

    def __init__(self, servo_ids: Sequence[int]) -> None:
        self.servos = {servo_id: EmulatedServo(servo_id) for servo_id in servo_ids}
        self.faults = LineFaults()
        self._stream = PacketStream()
        self._answers: list[bytes] = []
        self._late: list[bytes] = []
        self._damaged = 0
        self._now: float | None = None

    @property
    def dropped(self) -> int:
        """Number of damaged packets and refused writes."""
        return self._damaged + self._stream.damaged + sum(servo.refused for servo in self.servos.values())

    def reset(self, cause: int) -> None:
        """Open the port: the adapter drops unfinished packets; servos with power are not affected."""
        self._damaged += self._stream.damaged
        self._stream, self._answers, self._late = PacketStream(), [], []

    def feed(self, data: bytes, now: float) -> list[tuple[int, ...]]:
        """Process bytes; return the goals that all servos have accepted, in pulses, oldest first."""
        self.advance(now)
        poses = []
        for packet in self._stream.feed(data):
            if packet.instruction == Instruction.STATUS or self.faults.happens(self.faults.unheard):
                continue
            for servo in self.servos.values():
                servo.fed = now
            if self._carry_out(packet):
                poses.append(tuple(servo.goal for servo in self.servos.values()))
        self.accepted += len(poses)
        return poses

    def answer(self, now: float) -> bytes:
        """Return the status packets, with the faults of the line."""
        answers, self._late = self._late, []
        for each in self._answers:
            if self.faults.happens(self.faults.lost):
                continue
            if self.faults.happens(self.faults.damaged):
                each = _damage(each, self.faults.draw)
            (self._late if self.faults.happens(self.faults.late) else answers).append(each)
        self._answers = []
        return b"".join(answers)

    def say(self, now: float) -> bytes:
        """Return nothing, since servos send only responses; time passes."""
        self.advance(now)
        return b""

    def advance(self, now: float) -> None:
        """Advance the servos to `now`."""
        passed_s = 0.0 if self._now is None else min(max(now - self._now, 0.0), LONGEST_LAG_S)
        self._now = now
        for servo in self.servos.values():
            servo.advance(now, passed_s)

    @property
    def positions(self) -> dict[int, float]:
        """Positions of the servos in pulses, by id."""
        return {servo_id: servo.position for servo_id, servo in self.servos.items()}

    def _carry_out(self, packet: Packet) -> bool:
        """Execute a packet; return whether all servos have accepted goals from it."""
        body = packet.parameters
        if packet.instruction == Instruction.SYNC_WRITE and len(body) >= 4:
            address, size = struct.unpack_from("<HH", body)
            accepted = set()
            for at in range(4, len(body) - size, size + 1):
                servo, data = self.servos.get(body[at]), body[at + 1 : at + 1 + size]
                if servo is not None and servo.answers and servo.write(address, data) is None:
                    accepted.add(body[at])
            return address == table.GOAL_POSITION and accepted == set(self.servos)
        if packet.instruction in (Instruction.SYNC_READ, Instruction.BULK_READ):
            for servo_id, address, size in _places(packet.instruction, body):
                servo = self.servos.get(servo_id)
                if servo is None or not servo.answers:
                    break  # they respond in turn, and none after a missing one
                self._respond(servo_id, servo.read(address, size))
        elif packet.servo_id == BROADCAST:
            for servo_id, servo in sorted(self.servos.items()):
                if packet.instruction == Instruction.PING and servo.answers:
                    self._ask(servo_id, packet)
        elif packet.servo_id in self.servos and self.servos[packet.servo_id].answers:
            self._ask(packet.servo_id, packet)
        return False

    def _ask(self, servo_id: int, packet: Packet) -> None:
        servo, body = self.servos[servo_id], packet.parameters
        if packet.instruction == Instruction.PING:
            self._respond(servo_id, servo.get(0).to_bytes(2, "little") + bytes([servo.get(6)]))
        elif packet.instruction == Instruction.READ and len(body) == 4:
            self._respond(servo_id, servo.read(*struct.unpack("<HH", body)))
        elif packet.instruction == Instruction.WRITE and len(body) > 2:
            self._respond(servo_id, servo.write(int.from_bytes(body[:2], "little"), body[2:]) or b"")
        elif packet.instruction == Instruction.REBOOT:
            servo.power_cycle()
            self._respond(servo_id, b"")
        else:
            self._respond(servo_id, StatusError.INSTRUCTION)

    def _respond(self, servo_id: int, response: bytes | StatusError) -> None:
        alert = ALERT if self.servos[servo_id].get(HARDWARE_ERROR) else 0
        if isinstance(response, StatusError):
            self._answers.append(status(servo_id, b"", response | alert))
        else:
            self._answers.append(status(servo_id, response, alert))


def _damage(answer: bytes, draw: random.Random) -> bytes:
    """Cut a packet short, or flip one of its bits."""
    spoilt = bytearray(answer)
    at = draw.randrange(len(spoilt))
    if draw.random() < 0.3:
        return bytes(spoilt[:at])
    spoilt[at] ^= 1 << draw.randrange(8)
    return bytes(spoilt)


def _places(instruction: int, body: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield id, address and size for each servo that is read."""
    if instruction == Instruction.BULK_READ:
        for at in range(0, len(body) - 4, 5):
            yield struct.unpack_from("<BHH", body, at)
    elif len(body) >= 4:
        address, size = struct.unpack_from("<HH", body)
        for servo_id in body[4:]:
            yield servo_id, address, size
