"""The bridge's line in /diagnostics."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from servo_bridge.driver import ServoDriver
from servo_bridge.errors import PortError
from servo_bridge.protocols import Ability
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
            if driver.takeover.pending and not driver.waiting:
                why = driver.takeover.reason or "sending has begun"
                message, level = f"active, asking for the board's pose: {why}", DiagnosticStatus.ERROR
        values |= {
            "port": driver.port or "none",
            "mode": driver.motion.mode,
            "packets sent": counts.packets,
            "servo bytes": " ".join(map(str, driver.sent_bytes or ())) or "none",
            "command age [s]": "none" if age is None else f"{age:.3f}",
            "takeovers": driver.takeover.count,
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
    """What is known of the board: its protocol, what it can do, and what it said last."""
    link = driver.link
    if link is None:
        return {"link": "closed"}
    values: dict[str, object] = {"link": driver.link_state}
    try:
        with link.speaking() as board:
            abilities, said = board.abilities, dict(board.values())
    except PortError as error:
        return values | {"link fault": str(error)}
    values["board can"] = " ".join(str(each.name).lower() for each in Ability if each in abilities) or "none"
    age = driver.telemetry_age
    if age is not None:
        values |= {"telemetry age [s]": f"{age:.3f}", "board starts": driver.counts.restarts}
    tilt_age = driver.tilt_age
    if tilt_age is not None or Ability.IMU in abilities:
        values |= {
            "imu age [s]": "none" if tilt_age is None else f"{tilt_age:.3f}",
            "imu readings": link.tilts,
        }
    return values | said
