"""Why a measurement does not begin, or ends before its time."""

from __future__ import annotations

from softsim_core.errors import SoftSimError


class ExcitationError(SoftSimError, RuntimeError):
    """A robot cannot be measured, or not to the end; what was recorded before is kept."""
