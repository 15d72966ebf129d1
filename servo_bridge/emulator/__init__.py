"""The servo board without hardware: the real firmware in an emulated ATmega328P."""

from servo_bridge.emulator.board import FIRMWARE, EmulatedBoard
from servo_bridge.emulator.errors import EmulatorError, EmulatorMissingError
from servo_bridge.emulator.i2c import I2cRegisters
from servo_bridge.emulator.pty_board import EmulatedBoardPty
from servo_bridge.emulator.pulses import Pulse
from servo_bridge.emulator.simavr import why_missing

__all__ = [
    "FIRMWARE",
    "EmulatedBoard",
    "EmulatedBoardPty",
    "EmulatorError",
    "EmulatorMissingError",
    "I2cRegisters",
    "Pulse",
    "why_missing",
]
