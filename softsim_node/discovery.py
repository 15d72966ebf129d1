"""Who can see, and move, what this process runs: ROS discovery, this computer only unless asked otherwise."""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping

from softsim_core.errors import SoftSimError, listing

WISH = "SOFTSIM_DISCOVERY_RANGE"
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
PEERS = "ROS_STATIC_PEERS"
SKIP_CURRENT_FOLDER = "SKIP_DEFAULT_XML_FILE"
"""Set to 1, Fast DDS reads no `DEFAULT_FASTRTPS_PROFILES.xml` in the current folder, which may be foreign."""

REACHES = {
    "LOCALHOST": "nodes on this computer only",
    "SUBNET": "every computer on the local network: anybody there can move the robot",
    "OFF": "no other process",
    "SYSTEM_DEFAULT": "whatever the middleware's own configuration says",
}
"""Allowed values, and who is reached with them."""


class DiscoveryError(SoftSimError, ValueError):
    """The wish for a discovery range is none of those that ROS knows."""


def wished_range(environment: Mapping[str, str]) -> str:
    """The range for this process: SOFTSIM_DISCOVERY_RANGE, else LOCALHOST, or OFF where ROS is told so.

    ROS_AUTOMATIC_DISCOVERY_RANGE alone cannot widen it: a sourced ROS sets it to SUBNET where nobody asked.

    Raises:
        DiscoveryError: SOFTSIM_DISCOVERY_RANGE is not one of REACHES.
    """
    wish = environment.get(WISH, "")
    if not wish:
        return "OFF" if environment.get(RANGE) == "OFF" else "LOCALHOST"
    if wish not in REACHES:
        raise DiscoveryError(f"{WISH}={wish[:40]!r} is refused; allowed: {listing(REACHES)}; or unset it")
    return wish


def set_range(environment: MutableMapping[str, str]) -> None:
    """Make the range hold for a process with this environment, and for those that it starts.

    Raises:
        DiscoveryError: as `wished_range`.
    """
    environment[RANGE] = wished_range(environment)
    environment.pop("ROS_LOCALHOST_ONLY", None)  # of older releases: it would beat the range
    environment.setdefault(SKIP_CURRENT_FOLDER, "1")


def sentence(environment: Mapping[str, str]) -> str:
    """Who can reach the nodes of a process with this environment, and how to change it."""
    reach = wished_range(environment)
    peers = environment.get(PEERS, "")
    among = f", and the computers in {PEERS} ({peers[:60]})" if peers and reach != "OFF" else ""
    domain = environment.get("ROS_DOMAIN_ID") or "0"
    change = f"; {WISH}=SUBNET opens it to the network" if reach == "LOCALHOST" else ""
    return f"reached by {REACHES[reach]}{among} (domain {domain}, {reach}{change})"
