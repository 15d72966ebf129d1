"""The bridge's line in /diagnostics."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from servo_bridge.driver import ServoDriver


def bridge_status(
    name: str, state: str, driver: ServoDriver | None, *, e_stopped: bool, trouble: str, reconnects: int
) -> DiagnosticStatus:
    """Status message of the bridge.

    Args:
        name: Full name of the node.
        state: Lifecycle state.
        driver: The driver; None before the first configure.
        e_stopped: Whether the software e-stop is latched.
        trouble: Sentence of what keeps the bridge from working; empty when nothing does.
        reconnects: Times that a lost port was opened again.
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
