"""Where the time of a step goes, as a table: one status a stage, on the topic `stage_statistics`."""

from __future__ import annotations

from collections.abc import Mapping

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from softsim_ros.messages import header
from softsim_ros.messages.diagnostics import shown
from softsim_ros.simulator.pacing import StageTime

WHOLE = ("step", "publishing")
"""Stages that together are all of a step; the others are parts of the first."""


def stage_statistics(stamp: Time, robot: str, stages: Mapping[str, StageTime]) -> DiagnosticArray:
    """Calls, smallest, mean and largest time in [ms], and percent of the whole, of each stage."""
    whole = sum(stages[name].mean for name in WHOLE if name in stages)
    return DiagnosticArray(
        header=header(stamp, ""),
        status=[_status(name, robot, time, whole) for name, time in stages.items()],
    )


def _status(name: str, robot: str, time: StageTime, whole: float) -> DiagnosticStatus:
    values = {
        "calls": time.calls,
        "min_ms": round(time.minimum, 4),
        "mean_ms": round(time.mean, 4),
        "max_ms": round(time.maximum, 4),
        "percent": round(100.0 * time.mean / whole, 1) if whole > 0.0 else 0.0,
    }
    return DiagnosticStatus(
        name=name,
        hardware_id=robot,
        values=[KeyValue(key=key, value=shown(value)) for key, value in values.items()],
    )
