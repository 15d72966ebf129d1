"""Errors of the emulated board."""

from __future__ import annotations

from softsim_core.errors import SoftSimError


class EmulatorMissingError(SoftSimError, OSError):
    """The processor's emulator is not installed, or it is a version whose inside is not known."""


class EmulatorError(SoftSimError, RuntimeError):
    """The emulated processor cannot go on, or a firmware image cannot be loaded into it."""
