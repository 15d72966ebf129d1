"""The inverse controller's line in /diagnostics."""

from __future__ import annotations

from softsim_core.errors import listing
from softsim_core.units import MILLIMETRE
from softsim_ros.inverse.control_thread import ControlStatus
from softsim_ros.inverse.plant import Feedback
from softsim_ros.messages.diagnostics import ERROR, OK, WARN


def health(
    status: ControlStatus, alive: bool, feedback: Feedback, foreign_commands: int
) -> tuple[bytes, str, dict[str, object]]:
    """Level, sentence and values of the diagnostics.

    Args:
        status: What the control thread did lately.
        alive: Whether it runs.
        feedback: Which measured pose corrects the model.
        foreign_commands: Commands that somebody else sent while control was on.
    """
    report = status.report
    level, sentence = OK, status.sentence or status.mode
    if not alive:
        level, sentence = ERROR, "the control thread has ended; restart the inverse controller"
    elif status.fault:
        level = ERROR
    elif status.mode == "holding" or (
        report is not None and (report.status in ("unreachable", "stalled") or report.sensitivity_age > 0)
    ):
        level = WARN
    values: dict[str, object] = {"mode": status.mode, "feedback": feedback}
    if report is not None:
        values |= {
            "feedback_fresh": status.measured,
            "residual_mm": report.residual_m / MILLIMETRE,
            "residual_rad": report.residual_rad,
            "reachable": report.reachable,
            "active_limits": listing(report.active),
            "status": report.status,
            "sensitivity_age_ticks": report.sensitivity_age,
            "qp_ms": report.qp_ms,
            "tick_ms": report.tick_ms,
            "ticks_per_second": status.rate,
        }
    values |= {f"mean_{stage}_ms": time_ms for stage, time_ms in status.stages_ms}
    values |= {"time_behind_s": status.late_s, "foreign_commands": foreign_commands}
    return level, sentence, values
