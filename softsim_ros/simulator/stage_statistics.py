"""Where the time of a step goes, as a table: one status a stage, on the topic `stage_statistics`."""

from __future__ import annotations

from collections.abc import Mapping

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from softsim_core.dynamics.stages import StageShare, stage_tree
from softsim_ros.messages import header
from softsim_ros.messages.diagnostics import shown
from softsim_ros.simulator.pacing import StageTime


def stage_statistics(stamp: Time, robot: str, stages: Mapping[str, StageTime]) -> DiagnosticArray:
    """Each stage before its parts, with its level; see `_status` for the values."""
    tree = stage_tree({name: time.total for name, time in stages.items()})
    whole = sum(share.total for share in tree if share.level == 0)
    return DiagnosticArray(
        header=header(stamp, ""),
        status=[_status(share, robot, stages[share.name], whole) for share in tree],
    )


def _status(share: StageShare, robot: str, time: StageTime, whole: float) -> DiagnosticStatus:
    """Level, calls, times of a call and of all in [ms], and percent of the whole."""
    values = {
        "level": share.level,
        "calls": time.calls,
        "min_ms": round(time.minimum, 4),
        "mean_ms": round(time.mean, 4),
        "max_ms": round(time.maximum, 4),
        "deviation_ms": round(time.deviation, 4),
        "total_ms": round(time.total, 3),
        "percent": round(100.0 * time.total / whole, 1) if whole > 0.0 else 0.0,
    }
    return DiagnosticStatus(
        name=share.name,
        hardware_id=robot,
        values=[KeyValue(key=key, value=shown(value)) for key, value in values.items()],
    )
