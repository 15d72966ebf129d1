"""Parameters of the viewer: read before the node takes its namespace from the robot, declared on the node."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from softsim_node.parameters import declare, parameter, parameter_probe
from softsim_ros.keys.parameters import DEFAULT_ROBOT, KeySettings
from softsim_ros.viewer.guard import ViewerError

DEFAULT_PORT = 8080

TOKEN: Final = "SOFTSIM_PAGE_TOKEN"
TOKEN_FILE: Final = "SOFTSIM_PAGE_TOKEN_FILE"
"""Variables with the secret of the page, and with the file that holds it: no other account reads them."""

LONGEST_TOKEN: Final = 200
_TOKEN: Final = re.compile(rf"[A-Za-z0-9_-]{{8,{LONGEST_TOKEN}}}")


@dataclass(frozen=True, kw_only=True)
class ViewerSettings:
    """Where the page is served, and how it looks.

    Attributes:
        host: IP address that is listened on; 127.0.0.1 is this machine only.
        port: TCP port.
        no_token: Ask for no secret: every account of this machine may use the page.
        lite: Cheap light, for browsers without a graphics card.
    """

    host: str = parameter("127.0.0.1", "IP address to listen on; 127.0.0.1: this machine only", fixed=True)
    port: int = parameter(DEFAULT_PORT, "TCP port of the page", within=(1, 65535), fixed=True)
    no_token: bool = parameter(False, "No secret: every account here may use the page", fixed=True)
    lite: bool = parameter(False, "Cheap light and no shadows", fixed=True)


@dataclass(frozen=True, kw_only=True)
class TokenSetting:
    """The token as a parameter, as it was given once; the node has none, since others read its parameters.

    Attributes:
        token: Secret that browsers bring.
    """

    token: str = parameter("", "Secret that browsers bring; give it in SOFTSIM_PAGE_TOKEN", fixed=True)


def requested_settings() -> tuple[str, ViewerSettings, str]:
    """The robot, the settings and the token given to this process.

    Raises:
        ViewerError: the file of the token cannot be read, or holds none.
    """
    with parameter_probe("viewer", namespace=DEFAULT_ROBOT) as probe:
        given = declare(probe, TokenSetting()).token
        if given:
            probe.get_logger().warning(
                f"parameter token: every account reads it in the list of processes; give it in {TOKEN} or "
                f"in the file that {TOKEN_FILE} names"
            )
        return (
            declare(probe, KeySettings()).robot,
            declare(probe, ViewerSettings()),
            given or requested_token(os.environ),
        )


def requested_token(environment: Mapping[str, str]) -> str:
    """The secret that browsers bring, out of the environment or of a file that it names; empty: a new one.

    Raises:
        ViewerError: the file cannot be read, or holds no token.
    """
    if token := environment.get(TOKEN, "").strip():
        return _usable(token, TOKEN)
    if not (name := environment.get(TOKEN_FILE, "")):
        return ""
    try:
        with Path(name).expanduser().open("rb") as stream:
            data = stream.read(LONGEST_TOKEN + 2)
    except OSError as error:
        raise ViewerError(f"viewer: {TOKEN_FILE} names {name}: {error.strerror}") from error
    return _usable(data.decode(errors="replace").strip(), name)


def _usable(token: str, source: str) -> str:
    if not _TOKEN.fullmatch(token):
        raise ViewerError(
            f"viewer: {source} holds no token; one has 8 to {LONGEST_TOKEN} letters, digits, '_' and '-'"
        )
    return token
