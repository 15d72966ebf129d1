"""The servo board without hardware: the real firmware in an emulated ATmega328P."""

from servo_bridge.emulator.board import FIRMWARE, EmulatedBoard, Pulse
from servo_bridge.emulator.pty_board import EmulatedBoardPty
from servo_bridge.emulator.simavr import EmulatorError, EmulatorMissingError, I2cRegisters, why_missing

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
