"""Contact detection: where surfaces come close, and what passes what."""

from __future__ import annotations

from softsim_core.contact.detection.cones import Closeness
from softsim_core.contact.detection.detector import Detector, Proximities
from softsim_core.contact.detection.measure import measured_gaps

__all__ = ["Closeness", "Detector", "Proximities", "measured_gaps"]
