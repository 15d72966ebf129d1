"""An XM430-W210 without hardware: its control table, and its motion in time. Pure, no clock.

It refuses what a real one refuses, moves by its profile, is stopped by its bus watchdog, and can be
overloaded, turned by hand, or taken off the bus. Not modelled: load, gravity, current.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from servo_bridge.bus_servo import PULSES_PER_RAD
from servo_bridge.protocols import dynamixel_table as table
from servo_bridge.protocols.dynamixel_packets import StatusError
from servo_bridge.protocols.dynamixel_table import HardwareError
from softsim_core.mechanics.limits import JointLimits

MODEL, FIRMWARE = 1030, 45
TABLE_SIZE, RAM_START = 147, 64
LARGEST_ACCELERATION = 200.0 * PULSES_PER_RAD
"""What the motor reaches without a profile, in [pulses/s^2]; a guess."""

LONGEST_STEP_S = 0.005

HARDWARE_ERROR, WATCHDOG, PROFILE_VELOCITY = 70, table.BUS_WATCHDOG, table.PROFILE + 4


@dataclass(frozen=True, slots=True)
class Item:
    """One number of the control table.

    Attributes:
        size: Bytes.
        initial: Value after power-on.
        range: Values that may be written; None: it can only be read.
    """

    size: int
    initial: int
    range: tuple[int, int] | None = None


ITEMS: Mapping[int, Item] = MappingProxyType(
    {
        0: Item(2, MODEL),
        2: Item(4, 0),
        6: Item(1, FIRMWARE),
        7: Item(1, 1, (0, 252)),
        8: Item(1, 3, (0, 7)),
        9: Item(1, 250, (0, 254)),
        10: Item(1, 0, (0, 5)),
        11: Item(1, table.POSITION_MODE, (0, 16)),
        12: Item(1, 255, (0, 255)),
        13: Item(1, 2, (1, 2)),
        20: Item(4, 0, (-1_044_479, 1_044_479)),
        24: Item(4, 10, (0, 1023)),
        31: Item(1, 80, (0, 100)),
        32: Item(2, 160, (95, 160)),
        34: Item(2, 95, (95, 160)),
        36: Item(2, 885, (0, 885)),
        38: Item(2, 1193, (0, 1193)),
        44: Item(4, 330, (0, 1023)),
        48: Item(4, 4095, (0, 4095)),
        52: Item(4, 0, (0, 4095)),
        63: Item(1, 0x34, (0, 63)),
        64: Item(1, 0, (0, 1)),
        65: Item(1, 0, (0, 1)),
        68: Item(1, 2, (0, 2)),
        69: Item(1, 0),
        HARDWARE_ERROR: Item(1, 0),
        76: Item(2, 1920, (0, 16383)),
        78: Item(2, 100, (0, 16383)),
        80: Item(2, 0, (0, 16383)),
        82: Item(2, 0, (0, 16383)),
        84: Item(2, 800, (0, 16383)),
        88: Item(2, 0, (0, 16383)),
        90: Item(2, 0, (0, 16383)),
        WATCHDOG: Item(1, 0, (0, 127)),
        100: Item(2, 885, (-885, 885)),
        102: Item(2, 1193, (-1193, 1193)),
        104: Item(4, 0, (-1023, 1023)),
        table.PROFILE: Item(4, 0, (0, 32767)),
        PROFILE_VELOCITY: Item(4, 0, (0, 32767)),
        table.GOAL_POSITION: Item(4, 0, (0, 4095)),
        120: Item(2, 0),
        122: Item(1, 0),
        123: Item(1, 0),
        124: Item(2, 0),
        126: Item(2, 0),
        128: Item(4, 0),
        132: Item(4, 0),
        136: Item(4, 0),
        140: Item(4, 0),
        144: Item(2, 120),
        146: Item(1, 30),
    }
)
"""The table up to the temperature; addresses between are not defined, and read 0."""


class EmulatedServo:
    """One XM430-W210; times are seconds of any steady clock.

    Args:
        servo_id: Its number.

    Attributes:
        answers: Whether it is on the bus, with power.
        position: Where it stands, in pulses.
        velocity: In [pulses/s].
        goals: Least and largest goal that anybody ever told it, taken or not; None before the first.
        refused: Writes refused.
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
        self._fed = 0.0  # newest instruction packet on the bus
        self.power_cycle()

    def power_cycle(self) -> None:
        """Off and on: the settings stay, all else begins anew; it has no torque."""
        for address, item in ITEMS.items():
            if address >= RAM_START:
                self.put(address, item.initial)
        self.velocity = 0.0
        self.put(table.GOAL_POSITION, round(self.position))

    def get(self, address: int) -> int:
        """A number of its table."""
        raw = self._table[address : address + ITEMS[address].size]
        return int.from_bytes(raw, "little", signed=len(raw) > 1)

    def put(self, address: int, value: int) -> None:
        """Set a number of its table, allowed or not."""
        size = ITEMS[address].size
        self._table[address : address + size] = value.to_bytes(size, "little", signed=size > 1 and value < 0)

    @property
    def torque(self) -> bool:
        """Whether it has torque."""
        return bool(self.get(table.TORQUE_ENABLE))

    @property
    def goal(self) -> int:
        """Where it is to go, in pulses."""
        return self.get(table.GOAL_POSITION)

    def fail(self, error: HardwareError) -> None:
        """A hardware error; one that its setting names switches the torque off until the power was off."""
        self.put(HARDWARE_ERROR, self.get(HARDWARE_ERROR) | error)
        if error & self.get(63):
            self.put(table.TORQUE_ENABLE, 0)

    def turn(self, pulse: float) -> None:
        """Turn it by hand."""
        self.position = pulse

    def heard(self, now: float) -> None:
        """Some instruction packet was on the bus."""
        self._fed = now

    def read(self, address: int, size: int) -> bytes | StatusError:
        """Bytes of its table."""
        if size < 1 or address + size > TABLE_SIZE:
            return StatusError.ACCESS
        self.put(128, round(self.velocity / PULSES_PER_RAD / table.VELOCITY_UNIT))
        self.put(132, round(self.position))
        return bytes(self._table[address : address + size])

    def write(self, address: int, data: bytes) -> StatusError | None:
        """Write whole numbers from an address on; all or none. What is against it, or None."""
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
        """Let the time up to `now` pass."""
        start = now - passed_s
        limit_s = self.get(WATCHDOG) * table.WATCHDOG_UNIT_S
        trips = self.torque and 0 < self.get(WATCHDOG) <= 127 and now - self._fed > limit_s
        if trips:
            self._move(max(self._fed + limit_s - start, 0.0))
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
        """What is against a write, as a real servo says; None: nothing."""
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
