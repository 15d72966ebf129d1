"""Contact detection: where surfaces come close, and what passes what."""

from __future__ import annotations

from softsim_core.physics.contact.detection.detector import Closeness, Detector, Proximities, measured_gaps

__all__ = ["Closeness", "Detector", "Proximities", "measured_gaps"]
