"""The bridge's line in /diagnostics."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from servo_bridge.driver import ServoDriver
from servo_bridge.frames import BoardFlags
from servo_bridge.link import reset_cause_text
from servo_bridge.writer import PeriodFigures


def bridge_status(
    name: str,
    state: str,
    driver: ServoDriver | None,
    *,
    e_stopped: bool,
    trouble: str,
    reconnects: int,
    calibration: str = "",
    period: PeriodFigures | None = None,
) -> DiagnosticStatus:
    """Status message of the bridge.

    Args:
        name: Full name of the node.
        state: Lifecycle state.
        driver: The driver; None before the first configure.
        e_stopped: Whether the software e-stop is latched.
        trouble: Sentence of what keeps the bridge from working; empty when nothing does.
        reconnects: Times that a lost port was opened again.
        calibration: File of the servos' calibration; empty without one.
        period: How evenly packets are sent; None while none are.
    """
    level, message = DiagnosticStatus.OK, state
    values: dict[str, object] = {"state": state, "e_stop": e_stopped, "reconnects": reconnects}
    if driver is not None:
        age, counts = driver.command_age, driver.counts
        if state == "active":
            if driver.waiting:
                message = "active, waiting for the board to start"
            else:
                message = f"active, {driver.motion.mode}"
                level = DiagnosticStatus.OK if driver.motion.mode == "track" else DiagnosticStatus.WARN
        values |= {
            "port": driver.port or "none",
            "mode": driver.motion.mode,
            "packets sent": counts.packets,
            "servo bytes": " ".join(map(str, driver.sent_bytes or ())) or "none",
            "command age [s]": "none" if age is None else f"{age:.3f}",
            "commands clipped": driver.motion.clipped,
            "commands refused": counts.refused,
            "last refusal": counts.last_refusal or "none",
            "byte 100 replaced": counts.avoided,
            "calibration": calibration or "none",
        }
        values |= _link_values(driver)
    if period is not None:
        values |= {
            "send period [ms]": f"{period.mean_s * 1e3:.2f}",
            "send period off by [ms]": f"{period.worst_s * 1e3:.2f}",
            "packets left out": period.missed,
        }
    if e_stopped:
        level, message = DiagnosticStatus.WARN, f"{state}, e-stop latched"
    if trouble:
        level, message = DiagnosticStatus.ERROR, trouble
    return DiagnosticStatus(
        level=level,
        name=f"{name.lstrip('/')}: servo board",
        message=message,
        hardware_id="" if driver is None else driver.port,
        values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
    )


def _link_values(driver: ServoDriver) -> dict[str, object]:
    """What is known of the board: its protocol, and where it speaks what it said last."""
    link = driver.link
    if link is None:
        return {"link": "closed"}
    values: dict[str, object] = {"link": driver.link_state}
    if link.banner is not None:
        values |= {
            "firmware": f"{link.banner.major}.{link.banner.minor}",
            "reset cause": reset_cause_text(link.banner.reset_cause),
        }
    telemetry, age = link.telemetry, driver.telemetry_age
    if telemetry is not None and age is not None:
        values |= {
            "telemetry age [s]": f"{age:.3f}",
            "board flags": " ".join(str(flag.name).lower() for flag in BoardFlags if flag in telemetry.flags)
            or "none",
            "pulse widths [us]": " ".join(map(str, telemetry.widths_us)),
            "acknowledged": telemetry.seq,
            "frames unacknowledged": link.unacknowledged,
            "most unacknowledged": link.counts.most_unacknowledged,
            "board rejects": telemetry.rejects,
            "board overruns": telemetry.overruns,
            "telemetry damaged": link.frames_dropped,
            "board starts": driver.counts.restarts,
        }
    tilt_age = driver.tilt_age
    if tilt_age is not None or driver.protocol == "ascii_imu":
        values |= {
            "imu age [s]": "none" if tilt_age is None else f"{tilt_age:.3f}",
            "imu readings": link.counts.tilts,
            "lines ignored": link.lines_ignored,
        }
    return values
