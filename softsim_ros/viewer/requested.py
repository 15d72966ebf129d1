"""Parameters of the viewer: read before the node takes its namespace from the robot, declared on the node."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from rcl_interfaces.msg import IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node

from softsim_node.parameters import ParameterError
from softsim_ros.runtime import declare_switch, declare_text, parameter_probe

DEFAULT_ROBOT: Final = "tripod"
DEFAULT_PORT: Final = 8080


@dataclass(frozen=True)
class ViewerSettings:
    """Where the page is served, and how it looks.

    Attributes:
        host: IP address that is listened on; 127.0.0.1 is this machine only.
        port: TCP port.
        token: Secret that browsers bring; empty: one is made at each start.
        no_token: Ask for no secret: every account of this machine may use the page.
        lite: Cheap light, for browsers without a graphics card.
    """

    host: str = "127.0.0.1"
    port: int = DEFAULT_PORT
    token: str = ""
    no_token: bool = False
    lite: bool = False

    def declare(self, node: Node) -> ViewerSettings:
        """Declare the parameters on a node, these values as defaults; returns what they are there.

        Raises:
            ParameterError: a value given at start is not allowed.
        """
        host = declare_text(node, "host", self.host, "IP address to listen on; 127.0.0.1: this machine only")
        token = declare_text(node, "token", self.token, "secret that browsers bring; empty: a new one")
        open_to_all = declare_switch(
            node, "no_token", self.no_token, "no secret: every account here may use the page", read_only=True
        )
        lite = declare_switch(node, "lite", self.lite, "cheap light and no shadows", read_only=True)
        port = _declare_count(node, "port", self.port, "TCP port of the page", 1, 65535)
        return ViewerSettings(host, port, token, open_to_all, lite)


def _declare_count(node: Node, name: str, default: int, description: str, lower: int, upper: int) -> int:
    descriptor = ParameterDescriptor(
        description=description,
        read_only=True,
        integer_range=[IntegerRange(from_value=lower, to_value=upper, step=1)],
    )
    try:
        return int(node.declare_parameter(name, default, descriptor).value)
    except (InvalidParameterTypeException, InvalidParameterValueException) as error:
        raise ParameterError(
            f"parameter {name} is refused; allowed is a whole number from {lower} to {upper}"
        ) from error


def requested_settings() -> tuple[str, ViewerSettings]:
    """The robot and the settings given to this process."""
    with parameter_probe("viewer", namespace=DEFAULT_ROBOT) as probe:
        robot = declare_text(probe, "robot", DEFAULT_ROBOT, "name of the robot, which is its namespace")
        return robot, ViewerSettings().declare(probe)
