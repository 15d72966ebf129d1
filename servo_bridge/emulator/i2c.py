"""A device on the emulated board's I2C bus: registers behind an address, as sensors have them."""

from __future__ import annotations

from dataclasses import dataclass, field

# Conditions on the bus in messages of simavr: bits 8..15 of the value; address in 16..23, data in 24..31.
_START, _STOP, _ACKNOWLEDGE, _WRITE, _READ = 1 << 0, 1 << 1, 1 << 3, 1 << 4, 1 << 5


@dataclass(slots=True)
class I2cRegisters:
    """A device of 256 registers; the first byte written sets the register, the next ones go into it and on.

    Attributes:
        address: Address on the bus, 7 bits.
        registers: The registers' contents.
        present: Whether it answers; False for a cable that is off.
    """

    address: int
    registers: bytearray = field(default_factory=lambda: bytearray(256))
    present: bool = True
    _selected: int = -1
    _pointer: int | None = None

    def answer(self, value: int) -> int | None:
        """The bus's next message after a message of the processor; None where nothing is said."""
        conditions, address, data = value >> 8 & 0xFF, value >> 16 & 0xFF, value >> 24 & 0xFF
        if conditions & _STOP:
            self._selected = -1
        if conditions & _START:
            self._selected = -1
            if self.present and address >> 1 == self.address:
                self._selected = address
                if not address & 1:
                    self._pointer = None
                return self._message(_ACKNOWLEDGE, 1)
        if self._selected < 0:
            return None
        if conditions & _WRITE:
            if self._pointer is None:
                self._pointer = data
            else:
                self.registers[self._pointer] = data
                self._pointer = (self._pointer + 1) % 256
            return self._message(_ACKNOWLEDGE, 1)
        if conditions & _READ:
            pointer = self._pointer or 0
            self._pointer = (pointer + 1) % 256
            return self._message(_READ, self.registers[pointer])
        return None

    def _message(self, conditions: int, data: int) -> int:
        return conditions << 8 | self._selected << 16 | data << 24
