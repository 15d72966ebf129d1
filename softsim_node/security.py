"""Security of ROS 2 (SROS 2): a process that was asked to be secured is, or it does not start."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import rclpy

from softsim_core.errors import SoftSimError

ENABLE: Final = "ROS_SECURITY_ENABLE"
STRATEGY: Final = "ROS_SECURITY_STRATEGY"
ENFORCE: Final = "Enforce"

LONGEST_REASON: Final = 120


class SecurityError(SoftSimError, RuntimeError):
    """Security is asked for, and the middleware or its keys cannot give it."""


def is_wanted(environment: Mapping[str, str]) -> bool:
    """Whether ROS is asked to secure what a process with this environment sends."""
    return environment.get(ENABLE) == "true"


def need_security() -> None:
    """Make sure that secured nodes can be made; once rclpy runs in a process where they are wanted.

    Raises:
        SecurityError: they cannot be made; says why.
    """
    try:
        node = rclpy.create_node("security_check", start_parameter_services=False, enable_rosout=False)
    except Exception as error:  # classes of rclpy's extension
        reason = str(error).splitlines()[0].removeprefix("error creating node: ").split(", at /")[0]
        raise SecurityError(
            f"{ENABLE} is true, but no secured node can be made: {reason[:LONGEST_REASON]}; "
            "ROS 2 from PyPI has no DDS security: use apt's, or unset it"
        ) from error
    node.destroy_node()


def warning(environment: Mapping[str, str]) -> str:
    """What is to be said of a process that wants security and runs without it; empty: nothing."""
    if not is_wanted(environment) or environment.get(STRATEGY) == ENFORCE:
        return ""
    return (
        f"{ENABLE} is true, but not enforced: without keys for its enclave this process is open to "
        f"everybody; {STRATEGY}={ENFORCE} refuses to start then"
    )
