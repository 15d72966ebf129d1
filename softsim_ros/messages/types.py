"""Message classes by name, and diagnostics."""

from __future__ import annotations

import importlib
from collections.abc import Mapping

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from softsim_ros.messages.states import header


def load_message(type_name: str) -> type:
    """Return the class of a type such as "sensor_msgs/msg/JointState".

    Raises:
        ImportError, AttributeError: its package is not installed, or has no such type.
    """
    package, _, name = type_name.split("/")
    loaded: type = getattr(importlib.import_module(f"{package}.msg"), name)
    return loaded


OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


def format_value(value: object) -> str:
    """Return a value as text: floats with six significant digits, others as they print."""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def diagnostic_array(
    stamp: Time, name: str, hardware_id: str, level: bytes, message: str, values: Mapping[str, object]
) -> DiagnosticArray:
    """Return one status in a DiagnosticArray.

    Args:
        stamp: Time of the report.
        name: Component, for example "tripod/simulator".
        hardware_id: Name of the robot.
        level: OK, WARN or ERROR of this module.
        message: Text of the status.
        values: Named values in the order in which they are shown.
    """
    status = DiagnosticStatus(
        level=level,
        name=name,
        message=message,
        hardware_id=hardware_id,
        values=[KeyValue(key=key, value=format_value(value)) for key, value in values.items()],
    )
    return DiagnosticArray(header=header(stamp, ""), status=[status])
