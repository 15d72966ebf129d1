"""Parameters of the viewer: read before the node takes its namespace from the robot, declared on the node."""

from __future__ import annotations

from dataclasses import dataclass

from softsim_node.parameters import declare, parameter, parameter_probe
from softsim_ros.keys.parameters import DEFAULT_ROBOT, KeySettings

DEFAULT_PORT = 8080


@dataclass(frozen=True, kw_only=True)
class ViewerSettings:
    """Where the page is served, and how it looks.

    Attributes:
        host: IP address that is listened on; 127.0.0.1 is this machine only.
        port: TCP port.
        token: Secret that browsers bring; empty: one is made at each start.
        no_token: Ask for no secret: every account of this machine may use the page.
        lite: Cheap light, for browsers without a graphics card.
    """

    host: str = parameter("127.0.0.1", "IP address to listen on; 127.0.0.1: this machine only", fixed=True)
    port: int = parameter(DEFAULT_PORT, "TCP port of the page", within=(1, 65535), fixed=True)
    token: str = parameter("", "Secret that browsers bring; empty: a new one", fixed=True)
    no_token: bool = parameter(False, "No secret: every account here may use the page", fixed=True)
    lite: bool = parameter(False, "Cheap light and no shadows", fixed=True)


def requested_settings() -> tuple[str, ViewerSettings]:
    """The robot and the settings given to this process."""
    with parameter_probe("viewer", namespace=DEFAULT_ROBOT) as probe:
        return declare(probe, KeySettings()).robot, declare(probe, ViewerSettings())
