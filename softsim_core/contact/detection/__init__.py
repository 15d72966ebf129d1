"""Contact detection: where surfaces come close, and what passes what."""

from __future__ import annotations

from softsim_core.contact.detection.cones import false_closing
from softsim_core.contact.detection.detector import Detector, Proximities
from softsim_core.contact.detection.measure import measured_gaps

__all__ = ["Detector", "Proximities", "false_closing", "measured_gaps"]
