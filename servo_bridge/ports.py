"""Which serial port the board is on: by name, by its stable link, or by what its USB chip says of itself."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Protocol

from serial.tools import list_ports

from servo_bridge.errors import PortError
from servo_bridge.wording import printable
from softsim_core.errors import listing

BY_ID = Path("/dev/serial/by-id")
"""Links that keep their name when the port's number changes."""

BOARD_USB_IDS = {(0x2341, 0x0043), (0x2341, 0x0001), (0x2A03, 0x0043), (0x2341, 0x0243), (0x2341, 0x006A)}
"""Vendor and product of genuine Uno boards."""

CLONE_USB_IDS = {(0x1A86, 0x7523), (0x0403, 0x6001), (0x10C4, 0xEA60)}
"""USB-serial chips (CH340, FT232, CP210x) of cheap boards and of any other gadget: never chosen unasked.

Many of them have no serial number, or all the same.
"""

NAME_IT = "name it with the parameter port (port:=/dev/...)"


class PortInfo(Protocol):
    """The part of pyserial's ListPortInfo used here."""

    device: str
    vid: int | None
    pid: int | None
    serial_number: str | None
    location: str | None
    manufacturer: str | None
    description: str


def find_port(port: str = "", *, ports: Iterable[PortInfo] | None = None, by_id: Path = BY_ID) -> str:
    """The board's port: `port` itself when given, else the one board that is plugged in.

    Args:
        port: Name from the user; empty to search.
        ports: Serial ports of this machine; None asks the system.
        by_id: Folder of stable links.

    Returns:
        The name to open; a link of /dev/serial/by-id where there is one.

    Raises:
        PortError: no board, or more than one; the sentence lists what was seen.
    """
    if port:
        return port
    seen: list[PortInfo] = sorted(
        list_ports.comports() if ports is None else ports, key=lambda info: info.device
    )
    boards = {Path(info.device).resolve(): info.device for info in seen if _is_board(info)}
    links = sorted(by_id.iterdir()) if by_id.is_dir() else []
    for link in links:
        if "arduino" in link.name.lower() or link.resolve() in boards:
            boards[link.resolve()] = str(link)
    if len(boards) == 1:
        return next(iter(boards.values()))
    if boards:
        raise PortError("", f"several boards found ({', '.join(sorted(boards.values()))}); {NAME_IT}")
    clones = [f"{info.device} ({info.description})" for info in seen if (info.vid, info.pid) in CLONE_USB_IDS]
    if clones:
        raise PortError(
            "", f"no certain board found; {', '.join(clones)} may be one or any other gadget: {NAME_IT}"
        )
    others = ", ".join(info.device for info in seen) or "none"
    raise PortError("", f"no board found (serial ports seen: {others}); plug the board in, or {NAME_IT}")


def stable_name(port: str, by_id: Path = BY_ID) -> str:
    """The link of /dev/serial/by-id that leads to an open port; empty where there is none."""
    target = Path(port).resolve()
    links = sorted(by_id.iterdir()) if by_id.is_dir() else []
    return next((str(link) for link in links if link.resolve() == target), "")


def usb_identity(port: str, ports: Iterable[PortInfo] | None = None) -> str:
    """What the USB chip of a port says of itself and keeps when it is plugged in again.

    Args:
        port: Name of the port, or of a link to it.
        ports: Serial ports of this machine; None asks the system.

    Returns:
        Vendor, product and serial number; the socket in place of a serial number that does not tell one chip
        from another. Empty where there is no USB chip, as for a pseudo-terminal.
    """
    target = Path(port).resolve()
    seen = list_ports.comports() if ports is None else ports
    return next((_identity(info) for info in seen if Path(info.device).resolve() == target), "")


def _identity(info: PortInfo) -> str:
    if info.vid is None or info.pid is None:
        return ""
    socket = info.location or ""
    which = f"in USB socket {socket}"
    if info.serial_number and (info.vid, info.pid) not in CLONE_USB_IDS:
        _, _, interface = socket.partition(":")  # of several on one chip
        which = f"serial number {printable(info.serial_number)}{interface and f' interface {interface}'}"
    return f"USB {info.vid:04x}:{info.pid:04x} {which}"


def find_again(port: str, stable: str, usb: str = "", *, ports: Iterable[PortInfo] | None = None) -> str:
    """The port to open after one was lost: the same device, whatever its number; never another one.

    Args:
        port: Name from the person; empty searches, see `find_port`.
        stable: What `stable_name` said while the port was open; empty: there was no such name.
        usb: What `usb_identity` said then; empty: nothing.
        ports: Serial ports of this machine; None asks the system.

    Raises:
        PortError: the device is not there, though the name from the person may be, as another device; of
            `find_port` where neither name nor identity is known.
    """
    if usb:
        seen = list_ports.comports() if ports is None else ports
        there = [info.device for info in seen if _identity(info) == usb]
        if len(there) > 1:
            raise PortError(
                port, f"{listing(sorted(there))} are the same to USB ({usb}); plug in the configured one only"
            )
        found = there[0] if there else ""
    else:
        found = stable if stable and Path(stable).exists() else ""
    if found:
        return found
    if not usb and not stable:
        return find_port(port)
    other = f", and {port} may be another device by now" if port and Path(port).exists() else ""
    raise PortError(
        stable or port,
        f"{stable or usb} is not plugged in{other}; plug it in, or for another board cleanup and configure",
    )


def _is_board(info: PortInfo) -> bool:
    return (info.vid, info.pid) in BOARD_USB_IDS or "arduino" in (info.manufacturer or "").lower()
