"""From commands to packets on a serial port; no ROS."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from servo_bridge.driver.driver import ServoDriver

__all__ = ["ServoDriver"]


def __getattr__(name: str) -> Any:
    if name != "ServoDriver":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from servo_bridge.driver.driver import ServoDriver  # late: it imports protocols, which import servo

    return ServoDriver
